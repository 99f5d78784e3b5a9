"""Small fits: each part, and whole fits that recover known shapes, textures and cameras."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.fit import (
    DescentSettings,
    FitWeights,
    MeshFit,
    ShapeFit,
    ShapeSettings,
    TextureFit,
    TextureSettings,
    Views,
    carve,
    object_bounds,
)
from neural_renderer.apps.fit.descent import SmoothDescent, VectorAdam, smooth_once
from neural_renderer.meshes.topology import Topology
from tests.rounding import rounding


def ring() -> nr.Mesh:
    """Make a torus coloured by position."""
    vertices, faces = nr.torus(0.7, 0.28, 32, 16)
    cubes = (vertices[faces.long()].mean(1) * 0.5 + 0.5)[:, None, None, None].expand(-1, 2, 2, 2, -1)
    return nr.Mesh(vertices, faces, cubes)


def cameras(count: int, **lens: Any) -> nr.Camera:
    index = torch.arange(count)
    elevation = torch.tensor([75.0, 15.0, -40.0, 45.0])[index % 4]
    return nr.Camera.look_at(
        nr.get_points_from_angles(3.2, elevation, 360 / count * index), **{"viewing_angle": 22.0, **lens}
    )


@pytest.fixture(scope="module")
def views() -> Views:
    return Views.of(ring(), cameras(12), 64)


def test_views_say_what_does_not_fit(views: Views) -> None:
    with pytest.raises(ValueError, match=r"masks: expected shape \[12, H, W\]"):
        Views(views.camera, views.masks[:3])
    with pytest.raises(ValueError, match="got an empty mask in view 2"):
        Views(views.camera, torch.where(torch.arange(12)[:, None, None] == 2, 0.0, views.masks))
    with pytest.raises(TypeError, match="camera: expected a Camera"):
        Views("camera", views.masks)  # type: ignore[arg-type]


def test_some_of_the_views(views: Views) -> None:
    some = views[3:5]
    assert len(some) == 2 and torch.equal(some.masks, views.masks[3:5])
    assert torch.equal(some.camera.origin, views.camera.origin[3:5])
    assert torch.equal(views[[4, 3]].masks, views.masks[[4, 3]])


@pytest.mark.parametrize("kind", ["look_at", "orthographic", "projection"])
def test_moved_views_see_the_same(kind: str) -> None:
    mesh = ring()
    camera = cameras(3, orthographic=kind == "orthographic", scale=0.9)
    if kind == "projection":
        rotation = camera.rotation * torch.tensor([1.0, -1.0, 1.0])[:, None]
        lens = torch.tensor([[80.0, 0.0, 32.0], [0.0, 80.0, 32.0], [0.0, 0.0, 1.0]])
        t = -torch.einsum("bij,bj->bi", rotation, camera.origin)
        camera = nr.Camera.projection(lens, rotation, t, orig_size=64)
    views = Views.of(mesh, camera, 64)
    centre, scale = torch.tensor([0.1, -0.2, 0.05]), 0.7
    moved = views.normalized(centre, scale)
    iou = moved.quality(((mesh.vertices.detach() - centre) / scale, mesh.faces))["iou"]
    assert iou.min() > 0.995
    eye, forward = moved.eyes()
    eye_before, forward_before = views.eyes()
    torch.testing.assert_close(eye, (eye_before - centre) / scale, **rounding(32, 5))
    torch.testing.assert_close(forward, forward_before, **rounding(16))


def test_visual_hull_has_the_hole_and_contains_the_object(views: Views) -> None:
    centre, half = object_bounds(views)
    assert centre.abs().max() < 0.08 and half == pytest.approx(0.98, abs=0.1)
    vertices, faces = carve(views.normalized(centre, half), 32)
    topology = Topology.of(faces)
    assert len(vertices) - len(topology.edges) + len(faces) == 0  # the Euler characteristic of a torus
    corners = vertices[faces]
    volume = (corners[:, 0] * torch.linalg.cross(corners[:, 1], corners[:, 2])).sum() / 6 * half**3
    assert 0.8 < volume / (2 * math.pi**2 * 0.7 * 0.28**2) < 1.4
    assert views.normalized(centre, half).quality((vertices, faces))["iou"].mean() > 0.87


def test_silhouettes_that_do_not_meet(views: Views) -> None:
    masks = torch.zeros_like(views.masks)
    masks[::2, :8, :8] = 1
    masks[1::2, -8:, -8:] = 1
    with pytest.raises(ValueError, match="that meet in space"):
        object_bounds(Views(views.camera, masks))
    with pytest.raises(ValueError, match=r"that meet in \[-1, 1\]³"):
        carve(Views(views.camera, masks), 16)


def test_blur_is_the_inverse() -> None:
    vertices, faces = nr.icosphere(2)
    topology = Topology.of(faces)
    matrix = torch.eye(len(vertices))
    for a, b in topology.edges.tolist():
        matrix[a, a] += 5
        matrix[b, b] += 5
        matrix[a, b] -= 5
        matrix[b, a] -= 5
    values = torch.randn(len(vertices), 3, generator=torch.Generator().manual_seed(0))
    known = torch.linalg.solve(matrix, values)
    # The residual is below 1e-6 of the values, and the matrix makes nothing smaller; the solver's rounding is amplified
    # by its condition.
    condition = int(torch.linalg.cond(matrix))
    for smooth in (
        smooth_once(values, topology.edges, 5.0, tolerance=1e-6),
        SmoothDescent(topology, 5.0).smoothed(values),
    ):
        torch.testing.assert_close(smooth, known, **rounding(17 + 16 * condition, 4))


def test_vector_adam_keeps_directions() -> None:
    """The first step has the direction of the gradient, and the length of the rate where it is longest."""
    gradient = torch.tensor([[3.0, 4.0], [0.3, -0.4], [0.0, 0.0]])
    first = VectorAdam().step(torch.zeros(3, 2), gradient, 0.1)
    expected = -0.1 * torch.tensor([[0.6, 0.8], [0.06, -0.08], [0.0, 0.0]])
    torch.testing.assert_close(first, expected, **rounding(16, 0.1))


def test_sphere_is_subdivided_and_fits() -> None:
    target = nr.Mesh(nr.icosphere(3)[0] * torch.tensor([1.0, 0.5, 0.7]), nr.icosphere(3)[1])
    views = Views.of(target, cameras(12), 64)
    fit = ShapeFit(views, *nr.icosphere(2, 0.6), steps=60, subdivisions=1, rate=0.03)
    rows = [fit.advance() for _ in range(60)]
    assert fit.done and len(fit.shape[1]) == 4 * 320
    assert len(Topology.of(fit.shape[1]).hinges) == len(Topology.of(fit.shape[1]).edges)  # closed still
    assert rows[0]["iou"] < 0.75
    assert views.quality(fit.shape)["iou"].mean() > 0.95


def test_colours_move_the_shape_too(views: Views) -> None:
    mesh = ring()
    fit = ShapeFit(views, mesh.vertices * 0.9, mesh.faces, steps=12, color_from=0.5, gradient="edge")
    shapes = []
    while not fit.done:
        shapes.append(fit.shape)
        fit.advance()
    assert [len(shape) for shape in shapes] == [2] * 7 + [3] * 5  # colours begin with the seventh step
    assert len(fit.shape) == 3 and fit.shape[2].std() > 0.01
    assert views.quality(fit.shape)["iou"].mean() > views.quality(shapes[0])["iou"].mean() + 0.02
    with pytest.raises(ValueError, match="color_from: expected a fraction"):
        ShapeFit(views, mesh.vertices, mesh.faces, color_from=2)


def test_texture_of_a_known_mesh(views: Views) -> None:
    """The loss of conjugate gradients falls with each step, and the batch size does not change the result."""
    mesh = ring()
    fit = TextureFit(views, mesh.vertices, mesh.faces, size=3, steps=12)
    other = TextureFit(views, mesh.vertices, mesh.faces, size=3, steps=12, batch=len(views))
    before = views.quality(fit.shape)["psnr"].mean()
    losses = []
    while not fit.done:
        losses.append(fit.advance()["loss"])
        other.advance()
    assert all(late <= early * (1 + 1e-4) + 1e-7 for early, late in pairwise(losses)) and losses[-1] < 0.02 * losses[0]
    assert views.quality(fit.shape)["psnr"].mean() > max(35, before + 12)
    assert fit.shape[2].min() >= 0 and fit.shape[2].max() <= 1
    torch.testing.assert_close(fit.shape[2], other.shape[2], rtol=0, atol=1e-3)
    with pytest.raises(ValueError, match="expected photos"):
        TextureFit(Views(views.camera, views.masks), mesh.vertices, mesh.faces)


def test_texels_that_no_view_shows() -> None:
    """Three cameras see a red half, one sees a blue half; hidden texels between them blend both evenly."""
    vertices, faces = nr.icosphere(2, 0.6)
    place = vertices[faces.long()].mean(1)[:, 0]
    paint = torch.zeros(len(faces), 2, 2, 2, 3)
    paint[place > 0, ..., 0] = paint[place < 0, ..., 2] = 0.8
    eyes = torch.tensor([[1.2, 0.0, 0.0]] * 3 + [[-1.2, 0.0, 0.0]])
    fit = TextureFit(Views.of(nr.Mesh(vertices, faces, paint), nr.Camera.look_at(eyes), 64), vertices, faces, steps=60)
    while not fit.done:
        fit.advance()
    means = fit.shape[2].mean((1, 2, 3))
    torch.testing.assert_close(
        means[place > 0.4], torch.tensor([[0.8, 0.0, 0.0]]).expand(int((place > 0.4).sum()), 3), rtol=0, atol=0.02
    )
    torch.testing.assert_close(means[place.abs() < 0.1].mean(0), torch.tensor([0.4, 0.0, 0.4]), rtol=0, atol=0.03)


def test_what_stands_before_a_mesh_in_one_view() -> None:
    """A bright square in one of five views hardly changes the texture; the mean of the views would move by 0.16."""
    vertices, faces = nr.icosphere(2, 0.6)
    paint = torch.full((len(faces), 2, 2, 2, 3), 0.2)
    eyes = nr.get_points_from_angles(2.0, 0.0, torch.arange(5) * 8.0)
    views = Views.of(nr.Mesh(vertices, faces, paint), nr.Camera.look_at(eyes), 64)
    photos = views.photos.clone()
    photos[2, :, 24:40, 24:40] = 1.0
    textures = []
    for each in (views, replace(views, photos=photos)):
        fit = TextureFit(each, vertices, faces, size=3, steps=30)
        while not fit.done:
            fit.advance()
        textures.append(fit.shape[2])
    # The square has the weight (0.02 / |(0.8, 0.8, 0.8)|)² = 2e-4 of another view at each pixel that it covers whole.
    assert (textures[1] - textures[0]).abs().max() < 0.01


def test_a_mesh_as_files_split_it(views: Views) -> None:
    """Split vertices are merged; an unused vertex and a degenerate face do no harm."""
    mesh = ring()
    split = torch.cat((mesh.vertices[mesh.faces.long()].flatten(0, 1), torch.full((1, 3), 9.0)))
    faces = torch.cat((torch.arange(3 * len(mesh.faces)).view(-1, 3), torch.tensor([[0, 0, 1]])))
    fit = MeshFit(views, nr.Mesh(split, faces, torch.zeros(len(faces), 2, 2, 2, 3)), steps=2)
    assert len(fit.shape[0]) == len(mesh.vertices)
    same = MeshFit(views, nr.UVMesh(split, faces, torch.zeros(len(split), 2), torch.ones(2, 2, 3)), steps=2)
    assert torch.equal(same.shape[0], fit.shape[0])
    fit.advance()
    with pytest.raises(ValueError, match="start: expected a mesh in the world of the cameras"):
        MeshFit(views, nr.Mesh(mesh.vertices + 50, mesh.faces, mesh.textures))


@pytest.mark.parametrize("steps", [1, 2, 7, 10])
def test_when_a_sphere_is_subdivided(views: Views, steps: int) -> None:
    """Two subdivisions come after a third and two thirds of the steps."""
    vertices, faces = nr.icosphere(0, 0.6)
    fit = ShapeFit(views, vertices, faces, steps=steps, subdivisions=2)
    sizes = []
    while not fit.done:
        fit.advance()
        sizes.append(len(fit.shape[1]) // 20)
    assert sizes == [4 ** (3 * step // steps) for step in range(steps)]


def test_whole_fit_in_another_world() -> None:
    """The mesh is returned in the world of the cameras, and a resumed fit ends in the same shape."""
    mesh = ring()
    centre = torch.tensor([5.0, -3.0, 2.0])
    camera = cameras(12)
    moved = nr.Mesh(mesh.vertices * 2 + centre, mesh.faces, mesh.textures)
    camera = nr.Camera(camera.rotation, camera.origin * 2 + centre, camera.translation, viewing_angle=22.0)
    views = Views.of(moved, camera, 64)
    options: dict[str, Any] = {"cells": 24, "steps": 6, "texture_steps": 6, "texture_size": 3}
    fit = MeshFit(views, **options)
    state: dict[str, Any] = {}
    while not fit.done:
        if fit.phase == "texture" and fit.step == 3:
            state = copy.deepcopy(fit.state_dict())
        fit.advance()
    quality = views.quality((fit.mesh().vertices.detach(), fit.mesh().faces, fit.mesh().textures.detach()))
    assert quality["iou"].mean() > 0.93 and quality["psnr"].mean() > 18
    again = MeshFit(views, **options)
    again.load_state_dict(state)
    assert again.step == 3
    while not again.done:
        again.advance()
    for mine, theirs in zip(fit.shape, again.shape, strict=True):
        assert torch.equal(mine, theirs)


def test_keywords_set_single_settings_of_groups(views: Views) -> None:
    short = MeshFit(views, cells=16, steps=2, batch=3, texture_size=3, shape=ShapeSettings(color_from=0.5))
    groups = {"shape": ShapeSettings(2, 16, 0.5), "texture": TextureSettings(size=3), "descent": DescentSettings(3)}
    full = MeshFit(views, **groups)  # type: ignore[arg-type]
    for _ in range(3):
        assert short.advance() == full.advance()
    assert all(torch.equal(mine, theirs) for mine, theirs in zip(short.shape, full.shape, strict=True))
    with pytest.raises(TypeError, match="cell"):
        MeshFit(views, cell=16)


def test_options_that_do_not_fit(views: Views) -> None:
    with pytest.raises(ValueError, match="laplacian: expected a finite weight of at least 0"):
        FitWeights(laplacian=-1)
    with pytest.raises(ValueError, match='start: expected "hull", "sphere" or a Mesh'):
        MeshFit(views, "cube")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match='start: expected a Mesh with recover="texture", got none'):
        MeshFit(views, recover="texture")
