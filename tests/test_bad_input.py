"""What does not fit gets a sentence that names the argument; and with the checks off, nothing crashes."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

import neural_renderer as nr

VERTICES, FACES = nr.icosphere(0)
NAN, INF = float("nan"), float("inf")


def good(device):
    return {
        "vertices": VERTICES[None].to(device),
        "faces": FACES[None].to(device),
        "textures": torch.ones(1, len(FACES), 2, 2, 2, 3, device=device),
    }


def spoiled(value, where=(0, 3, 1)):
    vertices = VERTICES[None].clone()
    vertices[where] = value
    return vertices


BAD = {
    "vertices of rank 2": ("vertices", VERTICES, ValueError),
    "vertices of rank 4": ("vertices", VERTICES[None, None], ValueError),
    "vertices with 4 coordinates": ("vertices", torch.zeros(1, 12, 4), ValueError),
    "vertices with 2 coordinates": ("vertices", torch.zeros(1, 12, 2), ValueError),
    "vertices of integers": ("vertices", VERTICES[None].long(), TypeError),
    "vertices that are complex": ("vertices", VERTICES[None].to(torch.complex64), TypeError),
    "vertices of 8 bits": ("vertices", VERTICES[None].to(torch.float8_e4m3fn), TypeError),
    "vertices as a list": ("vertices", VERTICES[None].tolist(), TypeError),
    "vertices as an array": ("vertices", VERTICES[None].numpy(), TypeError),
    "no vertices at all": ("vertices", None, TypeError),
    "vertices with NaN": ("vertices", spoiled(NAN), ValueError),
    "vertices with infinity": ("vertices", spoiled(INF), ValueError),
    "vertices with minus infinity": ("vertices", spoiled(-INF), ValueError),
    "faces of rank 1": ("faces", FACES[:, 0], ValueError),
    "faces with 4 corners": ("faces", torch.zeros(1, 5, 4, dtype=torch.int32), ValueError),
    "faces of floats": ("faces", FACES[None].float(), TypeError),
    "faces of int16": ("faces", FACES[None].short(), TypeError),
    "faces of bool": ("faces", FACES[None].bool(), TypeError),
    "faces as a list": ("faces", FACES[None].tolist(), TypeError),
    "no faces at all": ("faces", None, TypeError),
    "faces of another batch": ("faces", FACES.expand(2, -1, -1), ValueError),
    "a face index below 0": ("faces", FACES[None] - 1, ValueError),
    "a face index of V": ("faces", FACES[None] + 1, ValueError),
    "a face index of 2^40": ("faces", FACES[None].long() + 2**40, ValueError),
    "textures of another batch": ("textures", torch.ones(2, 20, 2, 2, 2, 3), ValueError),
    "textures of other faces": ("textures", torch.ones(1, 19, 2, 2, 2, 3), ValueError),
    "textures of rank 5": ("textures", torch.ones(20, 2, 2, 2, 3), ValueError),
    "textures with 4 channels": ("textures", torch.ones(1, 20, 2, 2, 2, 4), ValueError),
    "textures that are no cubes": ("textures", torch.ones(1, 20, 2, 3, 2, 3), ValueError),
    "textures of size 0": ("textures", torch.ones(1, 20, 0, 0, 0, 3), ValueError),
    "textures of 8 bits": ("textures", torch.ones(1, 20, 2, 2, 2, 3).to(torch.float8_e4m3fn), TypeError),
    "textures of integers": ("textures", torch.ones(1, 20, 2, 2, 2, 3, dtype=torch.uint8), TypeError),
    "no textures at all": ("textures", None, ValueError),
}


@pytest.mark.parametrize("what", BAD)
def test_meshes(device, what):
    name, value, error = BAD[what]
    arguments = good(device)
    arguments[name] = value.to(device) if isinstance(value, torch.Tensor) else value
    with pytest.raises(error, match=rf"^{name}: expected .*got"):
        nr.Renderer(8, camera_mode="look_at")(*arguments.values())


@pytest.mark.parametrize("name", ["vertices", "faces", "textures"])
def test_sparse_meshes(device, name):
    arguments = good(device)
    arguments[name] = arguments[name].to_sparse()
    with pytest.raises(TypeError, match=rf"^{name}: expected a dense tensor, got"):
        nr.Renderer(8, camera_mode="look_at")(*arguments.values())
    with pytest.raises(TypeError, match=rf"^{name}: expected a dense tensor, got"):
        nr.render(tuple(value[0] for value in arguments.values()), nr.Camera.look_at((0, 0, 3)), 8)


RENDERER = {
    "no pixels": ("image_size", 0, ValueError),
    "fewer than no pixels": ("image_size", -5, ValueError),
    "one side of none": ("image_size", (8, 0), ValueError),
    "three sides": ("image_size", (8, 8, 8), ValueError),
    "half a pixel": ("image_size", 8.5, TypeError),
    "a word for a size": ("image_size", "big", TypeError),
    "no size": ("image_size", None, TypeError),
    "more than memory holds": ("image_size", 32768, ValueError, 64),
    "more than can be counted": ("image_size", 10**12, ValueError),
    "a size that is infinite": ("image_size", INF, ValueError),
    "near beyond far": ("near", 200.0, ValueError),
    "near equal to far": ("near", 100, ValueError),
    "near behind the camera": ("near", -1.0, ValueError),
    "near not a number": ("near", NAN, ValueError),
    "far as a word": ("far", "away", TypeError),
    "far as digits": ("far", "100", TypeError),
    "far without a number": ("far", torch.ones((), device="meta"), TypeError),
    "far as two numbers": ("far", torch.ones(2), TypeError),
    "far infinite": ("far", INF, ValueError),
    "an unknown estimator": ("gradient", "exact", ValueError),
    "a background of two colours": ("background_color", [0, 1], ValueError),
    "a background of words": ("background_color", ["red"], TypeError),
    "a negative eps": ("rasterizer_eps", -1.0, ValueError),
    "an eye with two coordinates": ("eye", [1, 2], ValueError),
    "an eye for another batch": ("eye", torch.rand(3, 3) + 1, ValueError, 2),
    "an eye that is a word": ("eye", "left", TypeError),
    "no field of view": ("viewing_angle", 0, ValueError),
    "a field of view too wide": ("viewing_angle", 90, ValueError),
    "light of two colours": ("light_color_ambient", [1, 1], ValueError),
    "a direction of light in the plane": ("light_direction", [1, 1], ValueError),
}


@pytest.mark.parametrize("what", RENDERER)
def test_renderers(device, what):
    name, value, error, *batch = RENDERER[what]
    renderer = nr.Renderer(8, camera_mode="look_at")
    setattr(renderer, name, value)
    arguments = good(device)
    if batch:
        arguments = {key: t.expand(*batch, *t.shape[1:]) for key, t in arguments.items()}
    # What the parts call it may be the end of the attribute's name.
    parts = {
        "eye": "eye|camera",
        "rasterizer_eps": "eps",
        "background_color": "background",
        "viewing_angle": "angle",
    }
    word = parts.get(name, name.removeprefix("light_"))
    with pytest.raises(error, match=rf"^[a-z_, ]*({word}|{word.rpartition('_')[2]})[a-z_, ]*: expected .*got"):
        renderer(*arguments.values())


def test_modes_and_outputs(device):
    renderer = nr.Renderer(8, camera_mode="look_at")
    with pytest.raises(ValueError, match=r"^mode: expected .*got 'sketch'"):
        renderer(*good(device).values(), mode="sketch")
    with pytest.raises(TypeError, match=r"^camera_mode: expected"):
        nr.Renderer(camera_mode=3)
    corners = torch.rand(1, 4, 3, 3, device=device)
    for outputs in ((), "normals", ("alpha", "normals")):
        with pytest.raises(ValueError, match=r"^outputs: expected"):
            nr.rasterize_images(corners, 8, outputs=outputs)


@pytest.mark.parametrize(
    ("corners", "error"),
    [
        (torch.rand(4, 3, 3), ValueError),
        (torch.rand(1, 4, 3, 2), ValueError),
        (torch.rand(1, 4, 4, 3), ValueError),
        (torch.ones(1, 4, 3, 3, dtype=torch.int64), TypeError),
        ([[1.0]], TypeError),
        (torch.full((1, 4, 3, 3), NAN), ValueError),
    ],
)
def test_corners(corners, error):
    for function in (nr.rasterize_silhouettes, nr.rasterize_depth):
        with pytest.raises(error, match=r"^faces: expected .*got"):
            function(corners, 8)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs two devices")
@pytest.mark.parametrize("name", ["vertices", "faces", "textures"])
def test_devices_that_differ(name):
    arguments = good("cuda")
    arguments[name] = arguments[name].cpu()
    with pytest.raises(ValueError, match=r"expected device .*got"):
        nr.Renderer(8, camera_mode="look_at")(*arguments.values())


def test_a_device_without_numbers():
    """Tensors of torch's device "meta" stand for those of any device."""
    with pytest.raises(ValueError, match=r"^faces: expected device .*got"):
        nr.vertices_to_faces(VERTICES[None], FACES.to("meta"))


@pytest.mark.parametrize("batch", [0, 1, 2])
@pytest.mark.parametrize("count", [0, 20])
def test_empty_batch_and_empty_mesh_show_the_background(device, batch, count):
    vertices = VERTICES.to(device).expand(batch, -1, -1).clone().requires_grad_()
    faces, textures = FACES[:count].to(device), torch.ones(batch, count, 2, 2, 2, 3, device=device, requires_grad=True)
    for anti_aliasing in (False, True):
        renderer = nr.Renderer(8, camera_mode="look_at", background_color=[0.1, 0.2, 0.3], anti_aliasing=anti_aliasing)
        rgb, depth, alpha = renderer(vertices, faces, textures)
        assert (rgb.shape, depth.shape, alpha.shape) == ((batch, 3, 8, 8), (batch, 8, 8), (batch, 8, 8))
        if not count:
            assert not alpha.any() and (depth == 100).all()
            assert torch.allclose(rgb, torch.tensor([0.1, 0.2, 0.3], device=device)[:, None, None].expand_as(rgb))
        (rgb.sum() + depth.sum() + alpha.sum()).backward()
        assert bool(vertices.grad.any()) == bool(batch and count)


def test_no_vertices_and_no_faces(device):
    vertices = torch.zeros(2, 0, 3, device=device)
    faces = torch.zeros(0, 3, dtype=torch.int32, device=device)
    assert not nr.Renderer(8, camera_mode="look_at")(vertices, faces, mode="silhouettes").any()


def test_large_but_finite_vertices_are_no_error(device):
    """Their sum overflows; they are finite all the same."""
    vertices = torch.full((1, 12, 3), 3e38, device=device)
    assert nr.Renderer(8, camera_mode="look_at")(vertices, FACES.to(device), mode="silhouettes").isfinite().all()


@pytest.fixture
def unchecked():
    nr.check_values(False)
    yield
    nr.check_values(True)


def test_unchecked_faces_that_cannot_be_drawn_are_not(device, unchecked):
    """A face with NaN or with an index out of range is left out; the others are as they were."""
    vertices, faces = VERTICES[None].to(device), FACES[None].to(device)
    renderer = nr.Renderer(32, camera_mode="look_at")
    bad = torch.tensor([[[0, 1, 99], [-1, 2, 3], [4, 5, 12]]], dtype=torch.int32, device=device)
    spoiled_vertices = torch.cat((vertices, torch.full((1, 1, 3), NAN, device=device)), 1)
    expected = renderer(vertices, faces, mode="depth")
    mixed = torch.cat((faces, bad), 1)
    for points in (vertices, spoiled_vertices):
        points = points.clone().requires_grad_()
        depth = renderer(points, mixed, mode="depth")
        assert torch.equal(depth, expected)
        depth.sum().backward()
        assert points.grad[:, :12].isfinite().all() and points.grad[:, :12].any()


ABUSE = """
import itertools, sys, torch
import neural_renderer as nr
device = sys.argv[1]
nr.check_values(False)
nan, inf = float("nan"), float("inf")
random = torch.Generator().manual_seed(0)
for number, wild in itertools.product(range(3), (nan, inf, -inf, 3e38, -3e38, 1e20, 0.0)):
    vertices = torch.randn(2, 20, 3, generator=random)
    vertices[torch.rand(2, 20, 3, generator=random) < (0.02, 0.3, 1)[number]] = wild
    vertices = vertices.to(device).requires_grad_()
    faces = torch.randint(-2, 22, (2, 40, 3), generator=random)
    faces[0, :6] = torch.tensor([2**31 - 1, -(2**31), 2**31 - 2])
    faces = faces.to(device)
    textures = torch.randn(2, 40, 3, 3, 3, 3, generator=random)
    textures[0, 0] = wild
    textures = textures.to(device).requires_grad_()
    for mode, perspective in (("look_at", True), ("look_at", False), ("none", True)):
        renderer = nr.Renderer(16, camera_mode=mode, perspective=perspective)
        rgb, depth, alpha = renderer(vertices, faces, textures)
        assert ((alpha >= 0) & (alpha <= 1)).all()
        if abs(wild) != 3e38:  # whose sums and squares are infinite
            assert ((depth > 0) & (depth <= 100.001)).all()
        (rgb.sum() + depth.sum() + alpha.sum()).backward()
        assert vertices.grad.shape == vertices.shape
    corners = torch.randn(2, 40, 3, 3, generator=random) * 10 ** (torch.randn(2, 40, 3, 3, generator=random) * 12)
    corners[torch.rand(corners.shape, generator=random) < 0.1] = wild
    corners = corners.to(device).requires_grad_()
    for size in ((1, 1), (3, 50), (32, 32)):
        images = nr.rasterize_images(corners, size, textures=textures, two_sided=True, perspective=number != 1)
        sum(image.sum() for image in images).backward()
print("done")
"""


def test_unchecked_abuse_crashes_nothing(device):
    """In its own process: indices far out of range, NaN, infinity, huge and denormal numbers, forward and backward."""
    command = [sys.executable, "-c", ABUSE, device]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "done"), done.stderr


HUGE = """
import torch
import neural_renderer as nr
for face, perspective in (
    ([[5.8751847e36, -0.5746547, 2], [-8.9511859e34, 0.9124366, 2], [1.0701537e36, -0.6133301, 2]], False),
    ([[1.1741470e36, 0.7379333, 2], [1.3826110e36, 0.0363356, 2], [-1.3739782e37, -0.5315698, 2]], False),
    ([[0.66869, -0.66627, 1.0516], [1e37, 0.19459, 2.5476], [0.91463, 0.73143, 2.9747]], True),
):
    corners = torch.tensor([[face]]).requires_grad_()
    images = nr.rasterize_images(corners, 32, outputs=("alpha", "depth"), two_sided=True, perspective=perspective)
    assert images.depth.isfinite().all()
    images.alpha.sum().backward()
    assert corners.grad.isfinite().all()
print("done")
"""


def test_huge_but_finite_corners():
    """Numbers that pass all checks, and whose products float32 cannot hold."""
    done = subprocess.run([sys.executable, "-c", HUGE], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "done"), done.stderr
