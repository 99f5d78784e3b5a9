"""Details of a shape: maps of normals and depth, the descent with remeshing, and fits that use both."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.values import save_output
from neural_renderer.apps.common.views.maps import to_world
from neural_renderer.apps.fit import DetailFit, DetailWeights, MeshFit, Views, load_views
from neural_renderer.apps.fit.detail.adaptive_descent import AdaptiveDescent
from neural_renderer.apps.fit.detail.pyramid import Pyramid, reduced, shortest_edge


def dented() -> tuple[Tensor, Tensor]:
    """Make a sphere with a dent that no outline shows."""
    vertices, faces = nr.icosphere(4, radius=0.9)
    depth = 0.35 * torch.exp(-(((vertices - torch.tensor([0.0, 0.0, -0.9])) / 0.35) ** 2).sum(1))
    return vertices * (1 - depth)[:, None], faces


def cameras(count: int) -> nr.Camera:
    index = torch.arange(count)
    elevation = torch.tensor([0.0, 50.0, -45.0, 20.0])[index % 4]
    return nr.Camera.look_at(nr.get_points_from_angles(3.2, elevation, 360 / count * index), viewing_angle=20.0)


@pytest.fixture(scope="module")
def views() -> Views:
    return Views.of(nr.Mesh(*dented()), cameras(10), 64, normals=True, depth=True)


def distance(shape: tuple[Tensor, ...], other: tuple[Tensor, ...]) -> float:
    """Mean distance from points on one surface to another, both ways."""
    found = []
    for a, b in ((shape, other), (other, shape)):
        points = nr.sample_points(a[:2], 2000, torch.Generator().manual_seed(0)).points
        found.append(float((nr.closest_points(b[:2], points).points - points).norm(dim=1).mean()))
    return max(found)


def test_maps_of_a_known_mesh(views: Views) -> None:
    assert views.normals is not None and views.depth is not None
    inside = views.masks > 0.999
    torch.testing.assert_close(views.normals.norm(dim=1)[inside], torch.ones(int(inside.sum())))
    assert (views.depth > 0).sum() >= inside.sum() and (views.depth[views.depth > 0] > 2.2).all()
    # What moves the world moves depth, not normals.
    moved = views.normalized(torch.tensor([0.1, 0.0, 0.2]), 2.0)
    torch.testing.assert_close(moved.depth, views.depth / 2)
    assert torch.equal(moved.normals, views.normals)
    some = views[[3, 1]]
    assert torch.equal(some.normals, views.normals[[3, 1]]) and torch.equal(some.depth, views.depth[[3, 1]])
    with pytest.raises(ValueError, match=r"normals: expected shape \[10, 3, 64, 64\]"):
        replace(views, normals=views.normals[:3])
    with pytest.raises(ValueError, match=r"depth: expected shape \[10, 64, 64\]"):
        replace(views, depth=views.depth[:, :3])


def test_reduced_views(views: Views) -> None:
    half = reduced(views, 2)
    direct = Views.of(nr.Mesh(*dented()), cameras(10), 32, normals=True, depth=True)
    torch.testing.assert_close(half.masks, direct.masks, rtol=0, atol=0.3)
    assert half.normals is not None and half.depth is not None and direct.normals is not None
    inside = torch.minimum(half.masks, direct.masks) > 0.999
    assert ((half.normals * direct.normals).sum(1)[inside] > 0.97).all()
    # Known where all four pixels are; then the mean over the pixel.
    assert direct.depth is not None
    known = half.depth > 0
    assert known[inside].all() and (half.depth - direct.depth)[known & inside].abs().mean() < 0.02


def test_levels_do_not_make_the_mesh_coarser(views: Views) -> None:
    larger = Views.of(nr.Mesh(*dented()), cameras(4), 256, normals=True)
    coarse, fine = Pyramid(larger, 1.0), Pyramid(larger, 1e-3)
    assert [max(coarse.at(part).size) for part in (0.0, 0.3, 1.0)] == [64, 128, 256]
    assert [max(fine.at(part).size) for part in (0.0, 0.3, 1.0)] == [256, 256, 256]
    assert max(Pyramid(larger, 1.0, 65).at(0.0).size) == 128
    # The object is about 2 long.
    width = float((larger.masks > 0.5).any(1).sum(1).float().median())
    assert shortest_edge(larger) == pytest.approx(3 * 2 / width, rel=0.1)
    # A fit that is resumed begins with the mesh of the state, which is finer, and keeps the levels of the first one.
    fit, again = (DetailFit(larger, *nr.icosphere(level, radius=0.85), steps=5) for level in (1, 5))
    again.load_state_dict(copy.deepcopy(fit.state_dict()))
    assert again.advance() == fit.advance()


def test_weights_of_zero_leave_outlines_alone(views: Views) -> None:
    fit = DetailFit(views, *nr.icosphere(3, radius=0.85), steps=5, weights=DetailWeights(normals=0, depth=0))
    for _ in range(5):
        numbers = fit.advance()
    assert numbers["loss"] == pytest.approx(numbers["silhouette"])


@pytest.mark.parametrize("name", ["normals", "depth"])
def test_hollow_that_outlines_do_not_show(views: Views, name: str) -> None:
    """From a sphere: the dent appears, the mesh stays closed, and a resumed fit goes on in the same way."""
    kept = replace(views, **{other: None for other in ("normals", "depth") if other != name})
    start = nr.icosphere(3, radius=0.85)
    fit = DetailFit(kept, *start, steps=30)
    state: Any = None
    while not fit.done:
        if fit.step == 26:
            state = copy.deepcopy(fit.state_dict())
        numbers = fit.advance()
    assert set(numbers) == {"loss", "iou", "silhouette", name}
    assert numbers["iou"] > 0.97
    # Outlines alone leave the sphere as it is there.
    assert distance(fit.shape, dented()) < 0.5 * distance(start, dented())
    edges = torch.sort(torch.stack((fit.shape[1], fit.shape[1].roll(-1, 1)), 2).reshape(-1, 2), 1).values
    assert (torch.unique(edges, dim=0, return_counts=True)[1] == 2).all()
    again = DetailFit(kept, *start, steps=30)
    again.load_state_dict(state)
    while not again.done:
        again.advance()
    assert torch.equal(again.shape[0], fit.shape[0]) and torch.equal(again.shape[1], fit.shape[1])


def test_descent_has_coarse_faces_where_it_moves() -> None:
    """A steady gradient at one side, and noise at the other: lengths grow there, and shrink here."""
    descent = AdaptiveDescent(*nr.icosphere(3))
    generator = torch.Generator().manual_seed(0)
    before = descent.vertices[:, 0].max()
    for _ in range(16):
        x = descent.vertices[:, :1]
        noise = torch.randn(x.shape[0], 3, generator=generator)
        gradient = torch.where(x > 0, torch.tensor([-1.0, 0.0, 0.0]), noise)
        descent.step(gradient, rate=0.05, smooth=0.0, least=0.02, most=0.5)
    x, target = descent.vertices[:, 0], descent.surface.target
    assert x.max() > before + 0.05
    assert target[x > 0.5].mean() > 1.5 * target[x < -0.5].mean()


def test_phases_of_a_fit(views: Views) -> None:
    fit = MeshFit(views, cells=16, steps=2, detail_steps=3, texture_steps=2)
    phases = []
    while not fit.done:
        fit.advance()
        phases.append(fit.phase)
        if fit.phase == "detail":
            fit.adjust("normals", 2.0)
            assert [knob.value for knob in fit.knobs() if knob.name == "normals"] == [2.0]
            other = MeshFit(views, cells=16, steps=2, detail_steps=3, texture_steps=2)
            other.load_state_dict(copy.deepcopy(fit.state_dict()))
            assert other.phase == "detail" and other.step == fit.step
    assert phases == ["shape"] * 2 + ["detail"] * 3 + ["texture"] * 2
    plain = replace(views, normals=None, depth=None)
    without = MeshFit(plain, cells=16, steps=1, texture_steps=1)
    without.advance()
    without.advance()
    assert without.phase == "texture"
    with pytest.raises(ValueError, match="detail_steps: expected 0 for views without normals and depth"):
        MeshFit(plain, cells=16, detail_steps=1)
    with pytest.raises(ValueError, match="views: expected normals or depth, got neither"):
        DetailFit(plain, *nr.icosphere(1))


@pytest.fixture
def folder(tmp_path: Path, views: Views) -> Path:
    """Write images, masks and cameras of three views, K, R, t by hand; maps come with each test."""
    rows = []
    for index in range(3):
        nr.save_image(tmp_path / f"{index}.png", torch.cat((views.photos[index], views.masks[index][None])))
        camera = views.camera
        R = camera.rotation[index] * torch.tensor([1.0, -1.0, 1.0])[:, None]
        rows.append({"file": f"{index}.png", "R": R.tolist(), "t": (-R @ camera.origin[index]).tolist()})
    focal = 32 / np.tan(np.radians(20))
    K = [[focal, 0, 32], [0, focal, 32], [0, 0, 1]]
    (tmp_path / "cameras.json").write_text(json.dumps({"K": K, "views": rows}))
    return tmp_path


@pytest.mark.parametrize("suffix", [".npy", ".png"])
def test_maps_in_files(folder: Path, views: Views, suffix: str) -> None:
    """Maps as the command render writes them come back."""
    for name, values in (("normals", views.normals), ("depth", views.depth)):
        (folder / name).mkdir()
        for index in range(3):
            image = values[index].movedim(0, 2) if name == "normals" else values[index]
            save_output(folder / name / f"{index}{suffix}", image.numpy(), name.removesuffix("s"))
    found = load_views(folder)
    assert found.normals is not None and found.depth is not None
    inside = views.masks[:3] > 0.999
    # Eight bits of a normal: half a step of 2 / 255 in each channel. Sixteen bits of depth: half of 1 / 1000.
    difference = (found.normals - views.normals[:3]).abs().amax(1)[inside].max()
    assert difference < (1e-6 if suffix == ".npy" else 2 / 255)
    assert (found.depth - views.depth[:3]).abs().max() < (1e-6 if suffix == ".npy" else 0.51e-3)
    plain = load_views(folder, maps=False)
    assert plain.normals is None and plain.depth is None
    half = load_views(folder, size=32)
    assert half.normals is not None and half.normals.shape == (3, 3, 32, 32)


def test_normals_in_camera_space(folder: Path, views: Views) -> None:
    """A normal map of a sphere is the same picture from everywhere: x to the right, y up, z towards the viewer."""
    sphere = Views.of(nr.Mesh.icosphere(4, radius=0.9), cameras(10)[:3], 64, normals=True, shading="smooth")
    line = torch.linspace(-1, 1, 65)[:-1] + 1 / 64
    y, x = torch.meshgrid(-line, line, indexing="ij")
    (folder / "normals").mkdir()
    # The ray through pixel (x, y) meets the sphere at the nearer of two points.
    tan, far, radius = np.tan(np.radians(20)), 3.2, 0.9
    ray = torch.nn.functional.normalize(torch.stack((x * tan, y * tan, -torch.ones_like(x)), 2), dim=2)
    middle = -far * ray[..., 2]
    reach = radius**2 - far**2 + middle**2
    point = (middle - reach.clamp(min=0).sqrt())[..., None] * ray + torch.tensor([0.0, 0.0, far])
    picture = torch.where((reach > 0)[..., None], point / radius, 0.0)
    for index in range(3):
        np.save(folder / "normals" / f"{index}.npy", picture.numpy())
    for camera in (sphere.camera, load_views(folder, maps=False).camera):
        world = to_world(picture.movedim(2, 0).expand(3, -1, -1, -1), camera)
        inside = (sphere.masks > 0.999) & (reach > 0.05)
        assert sphere.normals is not None
        assert ((world * sphere.normals).sum(1)[inside] > 0.99).all()
    found = load_views(folder, normals_in="camera")
    inside = (views.masks[:3] > 0.999) & (reach > 0.05)
    assert found.normals is not None
    assert ((found.normals * world).sum(1)[inside] > 0.999).all()


def test_maps_that_do_not_fit(folder: Path) -> None:
    for name in ("normals", "depth"):
        (folder / name).mkdir()
    with pytest.raises(FileNotFoundError, match=r"normals: expected a file 0.png or .npy for each image"):
        load_views(folder)
    for index in range(3):
        np.save(folder / "normals" / f"{index}.npy", np.ones((64, 64, 3)))
        np.save(folder / "depth" / f"{index}.npy", np.full((64, 64), np.nan))
    assert not load_views(folder).depth.any()  # type: ignore[union-attr]
    np.save(folder / "normals" / "1.npy", np.ones((64, 64)))
    with pytest.raises(ValueError, match=r"1.npy: expected numbers \[H, W, 3\], got float64 \[64, 64\]"):
        load_views(folder)
    np.save(folder / "normals" / "1.npy", np.ones((32, 64, 3)))
    with pytest.raises(ValueError, match="expected 64 x 64 pixels like the image, got 64 x 32"):
        load_views(folder)
    (folder / "normals" / "1.npy").write_bytes(b"no array")
    with pytest.raises(ValueError, match="expected an array, got a file that cannot be read"):
        load_views(folder)
    np.save(folder / "normals" / "1.npy", np.ones((64, 64, 3)))
    (folder / "depth" / "2.npy").unlink()
    Image.new("RGB", (64, 64)).save(folder / "depth" / "2.png")
    with pytest.raises(ValueError, match=r"2.png: expected a grey picture of 16 bits, got one of mode RGB"):
        load_views(folder)
    with pytest.raises(ValueError, match="depth_scale: expected"):
        load_views(folder, depth_scale=0.0)
    with pytest.raises(ValueError, match='normals_in: expected "world" or "camera"'):
        load_views(folder, normals_in="eye")  # type: ignore[arg-type]
