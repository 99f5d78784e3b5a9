"""Outputs of `render` beside colour: each against the geometry that it shows."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import pickle

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.outputs import OUTPUTS, SURFACE
from neural_renderer.rendering import forward as rendering
from tests.rounding import rounding

CAMERA = nr.Camera.look_at([[0.4, 0.8, -2.5], [2.0, -0.5, 1.5]], viewing_angle=25)
PLAIN = {"anti_aliasing": False}


def painted() -> nr.UVMesh:
    vertices, faces = nr.icosphere(2)
    uv = torch.rand(len(faces), 3, 2, generator=torch.Generator().manual_seed(0))
    return nr.UVMesh(vertices, faces, uv, torch.rand(8, 8, 3))


def at_faces(values: torch.Tensor, images: nr.Images) -> torch.Tensor:
    """Values of corners, [F, 3, C], weighted at every pixel: [B, C, H, W]."""
    corners = values[images.face_index.long().clamp(min=0)]
    return (corners * images.barycentric.movedim(1, -1)[..., None]).sum(3).movedim(3, 1)


@pytest.mark.parametrize("camera", [CAMERA, nr.Camera.look_at([[0.4, 0.8, -2.5]] * 2, orthographic=True, scale=0.7)])
def test_each_shows_the_surface_at_the_pixel(camera) -> None:
    mesh = painted()
    images = nr.render(mesh, camera, (40, 56), outputs=(*OUTPUTS, *SURFACE), **PLAIN)
    mask = images.face_index >= 0
    assert images.rgb.shape == (2, 3, 40, 56) and torch.equal(mask.float(), images.alpha)
    own = mask[:, None].float()
    for name, channels in {"normal": 3, "position": 3, "uv": 2, "barycentric": 3}.items():
        image = getattr(images, name)
        assert image.shape == (2, channels, 40, 56) and image.dtype == torch.float32
        assert (image * (1 - own) == 0).all(), name  # the background
    corners = mesh.vertices[mesh.faces.long()]
    torch.testing.assert_close(images.position, at_faces(corners, images) * own, **rounding(16, 1))
    torch.testing.assert_close(images.uv, at_faces(mesh.uv, images) * own, **rounding(16, 1))
    torch.testing.assert_close(images.barycentric.sum(1), mask.float(), **rounding(8, 1))
    # The same points from pixels and depth; screen coordinates round to 2⁻²⁴ of 2.5 units of depth and more.
    rows, columns = torch.meshgrid(torch.arange(40) + 0.5, torch.arange(56) + 0.5, indexing="ij")
    pixels = torch.stack((columns, rows), -1).reshape(1, -1, 2).expand(2, -1, -1)
    points = camera.unproject(pixels, images.depth.flatten(1), (40, 56)).view(2, 40, 56, 3).movedim(3, 1)
    assert ((points - images.position) * own).abs().max() < 1e-4
    faces = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], dim=-1)
    flat = torch.nn.functional.normalize(faces, dim=-1)[:, None].expand(-1, 3, 3)
    torch.testing.assert_close(images.normal, at_faces(flat, images) * own, **rounding(64, 1))
    smooth = nr.render(mesh, camera, (40, 56), outputs="normal", shading="smooth", **PLAIN).normal
    torch.testing.assert_close(smooth.norm(dim=1), mask.float(), **rounding(8, 1))
    assert ((smooth - images.position) * own).norm(dim=1).max() < 0.1  # a sphere's normal is the point itself
    inside = nr.render((mesh.vertices, mesh.faces.flip(1)), camera, (40, 56), outputs="normal", **PLAIN).normal
    torch.testing.assert_close(inside, images.normal, **rounding(64, 1))  # of the side that is visible


def test_anti_aliasing() -> None:
    mesh = painted()
    names = ("normal", "position", "uv", "alpha")
    images = nr.render(mesh, CAMERA, 32, outputs=names)
    large = nr.render(mesh, CAMERA, 64, outputs=names, **PLAIN)
    for name in names[:3]:
        mean = torch.nn.functional.avg_pool2d(getattr(large, name), 2)
        torch.testing.assert_close(getattr(images, name), mean, **rounding(64, 1))
    centres = nr.render(mesh, CAMERA, 32, outputs=("face_index", "barycentric"))
    plain = nr.render(mesh, CAMERA, 32, outputs=("face_index", "barycentric"), **PLAIN)
    assert torch.equal(centres.face_index, plain.face_index) and torch.equal(centres.barycentric, plain.barycentric)


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_gradients_are_those_of_deferred_shading(gradient) -> None:
    mesh, weight = nr.Mesh.icosphere(2).trainable(), torch.rand(2, 3, 24, 24)
    position = nr.render(mesh, CAMERA, 24, outputs=("position", "face_index"), gradient=gradient).position
    (found,) = torch.autograd.grad((position * weight).sum(), mesh.vertices)
    fragments = nr.fragments(mesh, CAMERA, 24, gradient=gradient)
    attributes = mesh.vertices if gradient == "edge" else None
    if attributes is None:
        still = nr.fragments((mesh.vertices.detach(), mesh.faces), CAMERA, 24, gradient=gradient)
        expected = fragments.composite(still.interpolate(mesh.vertices))
    else:
        corners = attributes[mesh.faces.long()][None]
        expected = fragments.blend(fragments.interpolate(attributes), 0.0, False, corner_values=corners)
    (theirs,) = torch.autograd.grad((expected * weight).sum(), mesh.vertices)
    torch.testing.assert_close(found, theirs, rtol=1e-3, atol=1e-4)
    weights = nr.render(mesh, CAMERA, 24, outputs="barycentric").barycentric
    (found,) = torch.autograd.grad((weights * weight).sum(), mesh.vertices)
    assert found.isfinite().all() and found.any()
    flat = nr.render(mesh, CAMERA, 24, outputs=("normal", "rgb"), gradient=gradient)
    flat.normal.add_(1.0)  # images may be changed in place
    (found,) = torch.autograd.grad((flat.normal * weight).sum(), mesh.vertices)
    assert found.isfinite().all() and found.any()


def sheet(cells: int) -> nr.UVMesh:
    """A flat sheet of squares, turned by 20°, whose texture coordinates are continuous over it."""
    side = torch.linspace(-0.8, 0.8, cells + 1)
    y, x = torch.meshgrid(side, side, indexing="ij")
    sine, cosine = math.sin(math.radians(20)), math.cos(math.radians(20))
    vertices = torch.stack((x * cosine - y * sine, x * sine + y * cosine, 0 * x), -1).reshape(-1, 3)
    number = torch.arange((cells + 1) ** 2).view(cells + 1, -1)
    squares = torch.stack((number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]), -1).reshape(-1, 4)
    faces = torch.cat((squares[:, [0, 1, 2]], squares[:, [0, 2, 3]])).int()
    return nr.UVMesh(vertices, faces, 0.8 * torch.stack((x, y), -1).reshape(-1, 2) + 0.5, torch.rand(4, 4, 3))


@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("pixels", [0.7, 1.0, 3.0])
def test_continuous_values_have_no_seams(pixels: float, anti_aliasing: bool) -> None:
    """However small the faces, the gradient of uv is that of interpolation and of the outline of the sheet."""
    size, camera = 24, nr.Camera.look_at([[0.0, 0.0, -3.0]], orthographic=True)
    mesh = sheet(round(0.8 * size / pixels)).trainable()
    options = {"gradient": "edge", "anti_aliasing": anti_aliasing}
    weight = torch.rand(1, 2, size, size, generator=torch.Generator().manual_seed(0))
    uv = nr.render(mesh, camera, size, outputs="uv", **options).uv
    (found,) = torch.autograd.grad((uv * weight).sum(), mesh.vertices)
    fragments = nr.fragments(mesh, camera, size, **options)
    expected = fragments.blend(fragments.interpolate(mesh.uv), 0.0, False, corner_values=mesh.uv[None])
    torch.testing.assert_close(uv, expected, **rounding(16, 1))
    (theirs,) = torch.autograd.grad((expected * weight).sum(), mesh.vertices)
    torch.testing.assert_close(found, theirs, rtol=1e-4, atol=1e-4 * float(theirs.abs().max()))


def test_normals_of_faces_smaller_than_a_pixel() -> None:
    """A waving sheet of triangles of half a square pixel moves: the mean gradient is that of the mean image."""
    size, shifts, step = 32, 6, 0.25 * 2 / 32
    camera = nr.Camera.look_at([[0.0, 0.0, -3.0]], orthographic=True)
    flat = sheet(26)
    x, y, _ = flat.vertices.unbind(1)
    vertices = torch.stack((x, y, 0.1 * torch.sin(6 * x) * torch.cos(5 * y)), 1)
    rows, columns = torch.meshgrid(*[torch.linspace(-1, 1, size)] * 2, indexing="ij")
    weight = torch.stack([torch.sin(4 * columns + n) * torch.cos(3 * rows - n) for n in range(3)])

    def value(shift: torch.Tensor) -> torch.Tensor:
        images = nr.render((vertices + shift, flat.faces), camera, size, outputs="normal", anti_aliasing=False)
        return (images.normal * weight).sum()

    found, differences = [], []
    for i, j in itertools.product(range(shifts), repeat=2):
        shift = torch.tensor([i + 0.5, j + 0.5, 0]) / shifts * 2 / size
        move = torch.zeros((), requires_grad=True)
        along = torch.tensor([1.0, 0.0, 0.0])
        found.append(torch.autograd.grad(value(shift + move * along), move)[0])
        with torch.no_grad():
            differences.append((value(shift + step * along) - value(shift - step * along)) / (2 * step))
    means = [torch.stack(values).mean() for values in (found, differences)]
    noises = [torch.stack(values).std() / shifts for values in (found, differences)]
    # Three standard errors, and 6 %: the surface bends within the pixels that stand for the colours nearby.
    assert abs(means[0] - means[1]) < 3 * math.hypot(*noises) + 0.06 * abs(means[1]), (means, noises)
    assert max(noises) < 0.05 * abs(means[1]), (means, noises)


def test_jumps_of_coordinates_and_of_corner_normals_are_seams() -> None:
    """Two halves of a square meet at x = 0 with uv of 0 and 1, and with normals of 45°: moving the edge moves both."""
    camera = nr.Camera.look_at([[0.0, 0.0, -3.0]], orthographic=True)
    vertices = torch.tensor([[x, y, abs(x)] for x in (-0.7, 0.0, 0.7) for y in (-0.7, 0.7)])
    faces = torch.tensor([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]])
    uv = torch.tensor([0.0, 0.0, 1.0, 1.0])[:, None, None].expand(-1, 3, 2)
    normals = torch.tensor([[-1.0, 0.0, -1.0]] * 2 + [[1.0, 0.0, -1.0]] * 2)[:, None].expand(-1, 3, -1) / 2**0.5
    mesh = nr.UVMesh(vertices, faces, uv, torch.rand(4, 4, 3), normals=normals)
    middle = (vertices[:, 0] == 0)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    for output, shading in (("uv", "flat"), ("normal", "smooth")):
        move = torch.zeros((), requires_grad=True)
        moved = dataclasses.replace(mesh, vertices=vertices + move * middle)
        image = getattr(nr.render(moved, camera, 20, outputs=output, shading=shading, anti_aliasing=False), output)
        channel = image[0, 0]
        (found,) = torch.autograd.grad(channel.sum(), move)
        jump = float(channel.detach().max() - channel.detach().min())
        rows = 14  # 0.7 of 20 rows are covered; the edge moves by 10 pixels for 1 unit, with both ends
        assert abs(abs(float(found)) - rows * 10 * jump) < 0.1 * rows * 10 * jump, (output, shading, float(found), jump)


def test_lists_of_meshes() -> None:
    meshes = [painted(), nr.UVMesh(*nr.cube(), torch.rand(8, 2), torch.rand(4, 4, 3))]
    names = ("normal", "position", "uv", "face_index", "barycentric")
    together = nr.render(meshes, CAMERA, 24, outputs=names, shading="smooth")
    for b, mesh in enumerate(meshes):
        alone = nr.render(mesh, CAMERA[b], 24, outputs=names, shading="smooth")
        for name in names:
            torch.testing.assert_close(getattr(together, name)[b], getattr(alone, name)[0], **rounding(64, 1))


def test_they_cost_nothing_unless_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no such image is requested, neither are they made nor do the others change."""
    made: list[object] = []
    make = rendering.surface_images
    monkeypatch.setattr(rendering, "surface_images", lambda *a, **k: made.append(a) or make(*a, **k))
    mesh = nr.Mesh.icosphere(1)
    plain = nr.render(mesh, CAMERA, 8)
    assert not made and set(vars(plain)) == {"rgb", "alpha", "depth"}
    more = nr.render(mesh, CAMERA, 8, outputs=("rgb", "alpha", "depth", "normal"))
    assert len(made) == 1
    for name in ("rgb", "alpha", "depth"):
        assert torch.equal(getattr(more, name), getattr(plain, name))


def test_images_keep_them() -> None:
    images = nr.render(nr.Mesh.icosphere(1), CAMERA, 8, outputs=("rgb", "face_index"))
    rgb, alpha, depth = images
    assert rgb is images.rgb and alpha is None and depth is None
    for copied in (copy.copy(images), pickle.loads(pickle.dumps(nr.Images(*map(torch.clone, (rgb, rgb, rgb)))))):
        assert isinstance(copied, nr.Images)
    assert torch.equal(copy.copy(images).face_index, images.face_index)
    assert not hasattr(images, "normal") and not hasattr(images, "depths")
    other = images.replace(rgb=2 * images.rgb)
    assert torch.equal(other.rgb, 2 * rgb) and other.face_index is images.face_index and images.rgb is rgb
    assert list(vars(images.replace(rgb=None, depth=rgb))) == ["depth", "face_index"]
    with pytest.raises(AttributeError, match="rgb: expected no change"):
        images.rgb = rgb
    with pytest.raises(AttributeError, match='got images of rgb, face_index; add "normal" to outputs'):
        images.normal.sum()


def test_errors() -> None:
    mesh = nr.Mesh.icosphere(1)
    with pytest.raises(ValueError, match='outputs: expected a UVMesh for "uv", got Mesh'):
        nr.render(mesh, CAMERA, 8, outputs=("uv",))
    with pytest.raises(ValueError, match=r"outputs: expected some of rgb, alpha, depth, normal, .* got normals"):
        nr.render(mesh, CAMERA, 8, outputs=("normals",))
    clip = torch.cat((mesh.vertices, 2 + mesh.vertices[:, 2:]), 1)
    with pytest.raises(ValueError, match='outputs: expected a camera for "position", got None'):
        nr.render((clip, mesh.faces), None, 8, outputs=("position",), light=None)
    index = nr.render((clip, mesh.faces), None, 8, outputs=("face_index",), light=None).face_index
    assert (index >= 0).any()
