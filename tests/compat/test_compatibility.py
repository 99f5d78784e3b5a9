"""Tests of the published packages, with their numbers, on real files."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from tests.paths import DATA, TEAPOT
from tests.rounding import EPS, STEP, relative, rounding

REFERENCES = DATA / "neural_renderer"


def to_batch(data: torch.Tensor) -> torch.Tensor:
    """As the published tests do: the data third of four, the others zero, so that empty meshes must draw nothing."""
    return torch.stack((torch.zeros_like(data),) * 2 + (data,) + (torch.zeros_like(data),))


@pytest.fixture
def teapot(device):
    vertices, faces = nr.load_obj(TEAPOT)
    textures = torch.ones(len(faces), 4, 4, 4, 3)
    return tuple(to_batch(t.to(device)) for t in (vertices, faces, textures))


@pytest.fixture
def blender():
    """The silhouette that Blender draws, whose background is white."""
    covered = np.asarray(Image.open(REFERENCES / "teapot_blender.png")).min(-1) != 255
    assert covered.sum() == 7580
    return torch.from_numpy(covered)


def look_at_renderer(**options):
    return nr.Renderer(camera_mode="look_at", image_size=256, anti_aliasing=False, **options)


@pytest.mark.parametrize("mode", ["silhouettes", "rgb", "depth"])
def test_teapot_covers_the_pixels_of_blender(teapot, blender, mode):
    renderer = look_at_renderer(light_intensity_ambient=1.0, light_intensity_directional=0.0)
    image = renderer(*teapot, mode=mode).cpu()
    drawn = image != renderer.far if mode == "depth" else image > 0
    drawn = drawn.all(1) if mode == "rgb" else drawn
    assert int((drawn[2] != blender).sum()) == 0
    assert not drawn[[0, 1, 3]].any()
    if mode != "depth":
        # A weighted mean of ones: the weights, their sum, and a few operations around them.
        assert ((image == 0) | ((image - 1).abs() < 32 * EPS)).all()


def test_teapot_depth(teapot):
    """Depth over the object, stretched to [0, 1], as the published picture stores it."""
    depth = look_at_renderer()(*teapot[:2], mode="depth")[2].cpu()
    background = depth == depth.max()
    depth[background] = depth[~background].min()
    stretched = (depth - depth.min()) / (depth.max() - depth.min())
    expected = np.asarray(Image.open(REFERENCES / "test_depth.png")) / 255
    np.testing.assert_allclose(stretched, expected, rtol=0, atol=2 * STEP)  # theirs is cut off to eight bits


@pytest.mark.parametrize("case", [0, 1])
@pytest.mark.parametrize("mode", ["rgb", "silhouettes"])
def test_gradient_fixtures(device, case, mode):
    """Two hand-listed gradients of one pixel: it lies outside the triangle, and inside. Zeros must be zeros."""
    fixture = json.loads((REFERENCES / "gradient_cases.json").read_text())["cases"][case]
    vertices = torch.tensor(fixture["vertices"], device=device)
    faces = torch.tensor(fixture["faces"], device=device)
    textures = torch.ones(len(faces), 4, 4, 4, 3, device=device)
    vertices, faces, textures = (to_batch(t) for t in (vertices, faces, textures))
    renderer = nr.Renderer(
        64,
        anti_aliasing=False,
        camera_mode="look_at",
        perspective=False,
        light_intensity_ambient=1.0,
        light_intensity_directional=0.0,
    )
    vertices.requires_grad_()
    image = renderer(vertices, faces, textures, mode=mode)
    image = image.mean(1) if mode == "rgb" else image
    pixel = image[:, fixture["pyi"], fixture["pxi"]]
    loss = (pixel - 1).abs() if fixture["loss"] == "|I-1|" else pixel.abs()
    loss.sum().backward()
    # Published values were computed in float32, within half a pixel; eps adds a hundredth.
    np.testing.assert_allclose(vertices.grad[2].cpu(), fixture["grad"], rtol=1e-2, atol=1e-6)
    assert not vertices.grad[[0, 1, 3]].any()


def test_depth_gradient_fixture(device):
    """Against finite differences, in the image that shows the triangle (the published test looks at another)."""
    fixture = json.loads((REFERENCES / "gradient_cases.json").read_text())["depth_case"]
    vertices, faces = (to_batch(torch.tensor(fixture[name], device=device)) for name in ("vertices", "faces"))
    renderer = nr.Renderer(64, anti_aliasing=False, camera_mode="none")

    def loss(points):
        depth = renderer(points, faces, mode="depth")
        assert depth[2, 15, 20] < 3 and (depth[[0, 1, 3]] == 100).all()
        return (depth[2, 15, 20] - 1).square()

    vertices.requires_grad_()
    loss(vertices).backward()
    differences = torch.zeros(3, 3)
    for k in range(3):
        for axis in range(3):
            step = torch.zeros_like(vertices)
            step[2, k, axis] = 1e-3
            with torch.no_grad():
                differences[k, axis] = (loss(vertices + step) - loss(vertices - step)) / 2e-3
    assert differences.abs().max() > 0.1
    # A loss near 1 in float32, a few roundings off, over 2e-3.
    torch.testing.assert_close(vertices.grad[2].cpu(), differences, rtol=0, atol=16 * EPS / 2e-3 + 1e-4)
    assert not vertices.grad[[0, 1, 3]].any()


def test_teapot_shaded(teapot):
    """The published picture of the lit teapot: of its 196,608 values, a few at edges are off by more than 2."""
    renderer = look_at_renderer()
    found = (renderer(*teapot, mode="rgb")[2].permute(1, 2, 0).cpu() * 255).round()
    expected = torch.from_numpy(np.asarray(Image.open(REFERENCES / "test_rasterize1.png")).astype(np.float32))
    assert int(((found - expected).abs() > 2).sum()) <= 12


def test_look_at_and_perspective(device):
    point = torch.tensor([[[1.0, 0, 0]]], device=device)
    half = 0.5**0.5
    for eye, expected in (
        ((1, 0, 1), (-half, 0, half)),
        ((0, 0, -10), (1, 0, 10)),
        ((-1, 1, 0), (0, half, 1.5 * 2**0.5)),
    ):
        np.testing.assert_allclose(nr.look_at(point, eye)[0, 0].cpu(), expected, **rounding(16, 10))
    found = nr.perspective(torch.tensor([[[1.0, 2, 10]]], device=device))
    np.testing.assert_allclose(found[0, 0].cpu(), (3**0.5 / 10, 2 * 3**0.5 / 10, 10), **relative(8))


def test_lighting_of_many_faces(device):
    """Half the light is ambient; the other half falls along −y, on the cosine of the normal."""
    faces, textures = torch.randn(64, 16, 3, 3, device=device), torch.randn(64, 16, 8, 8, 8, 3, device=device)
    first, second, third = faces.double().unbind(2)
    normals = torch.linalg.cross(first - second, third - second)
    light = 0.5 + 0.5 * (normals[..., 1] / normals.norm(dim=-1)).clamp(min=0)
    expected = textures * light[..., None, None, None, None]
    # A thin face among so many has a normal from sides that cancel to a thousandth.
    torch.testing.assert_close(nr.lighting(faces, textures).double(), expected, rtol=1e-4, atol=1e-4)


def test_load_obj():
    expected = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]])
    vertices, faces = nr.load_obj(REFERENCES / "tetrahedron.obj", normalization=False)
    assert torch.equal(vertices, expected) and faces.dtype == torch.int32
    assert faces.tolist() == [[1, 3, 2], [3, 1, 0], [2, 0, 1], [0, 2, 3]]
    assert torch.equal(nr.load_obj(REFERENCES / "tetrahedron.obj")[0], expected * 2 - 1)
    vertices, faces = nr.load_obj(TEAPOT)
    assert (len(vertices), len(faces)) == (1292, 2464)


def test_save_obj(tmp_path):
    vertices, faces = nr.load_obj(TEAPOT)
    nr.save_obj(tmp_path / "teapot.obj", vertices, faces)
    again, same = nr.load_obj(tmp_path / "teapot.obj", normalization=False)
    assert torch.equal(again, vertices) and torch.equal(same, faces)


def test_rasterize_functions(device):
    """Shapes, orders and defaults of the bare functions; `Rasterize` is not turned, not averaged, channels last."""
    random = torch.Generator().manual_seed(0)
    faces = (torch.rand(2, 9, 3, 3, generator=random) * 2 - 1 + torch.tensor([0, 0, 2.0])).to(device)
    textures = torch.rand(2, 9, 2, 2, 2, 3, generator=random).to(device)
    images = nr.rasterize_rgbad(faces, textures, 20)
    assert [(name, tuple(image.shape)) for name, image in images.items()] == [
        ("rgb", (2, 3, 20, 20)),
        ("alpha", (2, 20, 20)),
        ("depth", (2, 20, 20)),
    ]
    assert torch.equal(nr.rasterize(faces, textures, 20), images["rgb"])
    assert torch.equal(nr.rasterize_silhouettes(faces, 20), images["alpha"])
    assert torch.equal(nr.rasterize_depth(faces, 20), images["depth"])
    only = nr.rasterize_rgbad(faces, image_size=20, return_rgb=False, return_depth=False)
    assert only["rgb"] is only["depth"] is None and torch.equal(only["alpha"], images["alpha"])
    assert nr.rasterize_silhouettes(faces).shape == (2, 256, 256)
    plain = nr.rasterize_rgbad(faces, textures, 20, anti_aliasing=False, background_color=(1, 0, 0))
    rgb, alpha, depth = nr.Rasterize(20, 0.1, 100, 1e-4, (1, 0, 0), True, True, True)(faces, textures)
    assert torch.equal(rgb, plain["rgb"].permute(0, 2, 3, 1).flip(1))
    assert torch.equal(alpha, plain["alpha"].flip(1)) and torch.equal(depth, plain["depth"].flip(1))
    with pytest.raises(ValueError, match="return_rgb"):
        nr.Rasterize(20, 0.1, 100, 1e-4, (0, 0, 0))


def test_names():
    published = """Renderer Rasterize rasterize rasterize_depth rasterize_rgbad rasterize_silhouettes look look_at
    perspective projection lighting get_points_from_angles vertices_to_faces load_obj save_obj Mesh Adam __version__"""
    assert all(hasattr(nr, name) for name in published.split())
