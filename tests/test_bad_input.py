"""Wrong arguments give an error that names them; with the checks off, nothing crashes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

import neural_renderer as nr
from tests.programs import run_python

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
    "faces of fractions": ("faces", FACES[None] + 0.5, ValueError),
    "faces with NaN": ("faces", torch.where(FACES == 3, NAN, FACES)[None], ValueError),
    "faces with infinity": ("faces", torch.where(FACES == 3, INF, FACES)[None], ValueError),
    "faces that are complex": ("faces", FACES[None].to(torch.complex64), TypeError),
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
    "near not a number": ("near", NAN, ValueError),
    "far as a word": ("far", "away", TypeError),
    "far as digits": ("far", "100", TypeError),
    "far without a number": ("far", torch.ones((), device="meta"), TypeError),
    "far as two numbers": ("far", torch.ones(2), TypeError),
    "far infinite": ("far", INF, ValueError),
    "far with too many digits": ("far", 10**400, ValueError),
    "far beyond the sum of four": ("far", 3e38, ValueError),
    "light that float32 does not hold": ("light_intensity_ambient", 1e39, ValueError),
    "light of too many digits": ("light_intensity_directional", 10**400, ValueError),
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
    # Messages may use the last part of the attribute's name.
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
    for outputs in ((), "normals", ("alpha", "normals"), [3], torch.ones(2)):
        with pytest.raises(ValueError, match=r"^outputs: expected"):
            nr.rasterize_images(corners, 8, outputs=outputs)
    with pytest.raises(TypeError, match=r"^outputs: expected .*got Tensor"):
        nr.rasterize_images(corners, 8, outputs=torch.tensor(NAN))
    assert nr.rasterize_images(corners, 8, outputs=np.array(["alpha", "depth"])).depth is not None


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


@pytest.mark.two_devices
@pytest.mark.parametrize("name", ["vertices", "faces", "textures"])
def test_devices_that_differ(name):
    arguments = good("cuda")
    arguments[name] = arguments[name].cpu()
    with pytest.raises(ValueError, match=r"expected device .*got"):
        nr.Renderer(8, camera_mode="look_at")(*arguments.values())


def test_a_device_without_numbers():
    """Tensors of torch's device "meta" represent tensors of any device."""
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


@pytest.mark.parametrize("gradient", ["nmr", "edge", "opendr"])
@pytest.mark.parametrize("cameras", [0, 1])
def test_no_cameras_or_no_meshes_give_no_images(device, cameras, gradient):
    """One of both has a batch of 1, which tasks of the backward pass must not count for an image."""
    camera = nr.Camera.look_at(torch.zeros(0, 3) if cameras == 0 else torch.tensor([[0.0, 1.0, 2.7]]))
    vertices = VERTICES.to(device)[None][: 1 - cameras].clone().requires_grad_()
    textures = torch.rand(20, 2, 2, 2, 3, device=device, requires_grad=True)
    images = nr.render((vertices, FACES.to(device), textures), camera, 8, gradient=gradient)
    assert [len(image) for image in images] == [0, 0, 0]
    sum(image.sum() for image in images).backward()
    assert not vertices.grad.any() and not textures.grad.any()
    fragments = nr.fragments((vertices, FACES.to(device)), camera, 8)
    assert len(fragments.interpolate(torch.rand(1 - cameras, len(VERTICES), 3, device=device))) == 0


def test_images_without_faces(device):
    """However many images a mesh without faces has, it shows the background."""
    camera, none = nr.Camera.look_at((0, 0, 3)), torch.zeros(0, 3, dtype=torch.int32, device=device)
    for count in range(4):
        images = (torch.rand(2, 2, 3, device=device),) * count
        empty = torch.zeros(0, 3, 3, device=device), none[:, 0].long()
        mesh = nr.UVMesh(VERTICES.to(device), none, empty[0][..., :2], empty[1], images, empty[0], ("repeat",) * count)
        found = nr.render(mesh, camera, 8, background=(0.1, 0.2, 0.3))
        assert not found.alpha.any() and torch.equal(found.rgb[0, :, 4, 4].cpu(), torch.tensor([0.1, 0.2, 0.3]))


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_one_texture_coordinate_that_is_not_finite(device, value, dtype):
    """With mipmaps and without, in each way to wrap, among few pixels and among many."""
    for side in (4, 80):
        uv = torch.full((1, side, side, 2), 0.5, dtype=dtype, device=device)
        uv[0, 1, 2, 1] = value
        seen = torch.zeros(1, side, side, dtype=torch.int32, device=device)
        for index, wrap in itertools.product((None, seen), ("repeat", "clamp", "mirror")):
            with pytest.raises(ValueError, match=r"^uv: expected finite numbers, got 1 that are NaN or infinite"):
                nr.sample_texture(torch.rand(4, 4, 3, device=device), uv, index, wrap=wrap)


def test_what_is_interpolated_or_sampled_has_to_be_finite(device):
    """But where no face is seen, nothing is looked at."""
    fragments = nr.fragments((VERTICES.to(device), FACES.to(device)), nr.Camera.look_at((0, 0, 3)), 8)
    colors, texture, uv = torch.rand(1, 16, 16, 3), torch.rand(4, 4, 3), torch.rand(1, 16, 16, 2)
    colors, texture, uv = (t.to(device) for t in (colors, texture, uv))
    calls = {
        "attributes": lambda value: fragments.interpolate(torch.full((12, 3), value, device=device)),
        "colors": lambda value: fragments.composite(torch.full_like(colors, value)),
        "texture": lambda value: nr.sample_texture(torch.full_like(texture, value), uv),
        "uv": lambda value: nr.sample_texture(texture, torch.full_like(uv, value), fragments.face_index),
        "light": lambda value: nr.rasterize_images(
            fragments.corners, 8, textures=torch.rand(1, 20, 2, 2, 2, 3, device=device),
            light=torch.full((1, 2, 20, 3), value, device=device),
        ),
        "corners": lambda value: nr.Light().two_sided(torch.full((1, 4, 3, 3), value)),
        "normals": lambda value: nr.SphericalHarmonicLight(torch.ones(9, 3)).on(torch.full((1, 4, 3), value)),
    }  # fmt: skip
    for name, call in calls.items():
        call(0.5)
        for value in (NAN, INF, -INF):
            with pytest.raises(ValueError, match=f"^{name}: expected finite numbers, got"):
                call(value)
    empty = ~fragments.mask
    expected = fragments.composite(colors), nr.sample_texture(texture, uv, fragments.face_index)
    colors[empty], uv[empty] = NAN, NAN
    assert torch.equal(fragments.composite(colors), expected[0])
    assert torch.equal(nr.sample_texture(texture, uv, fragments.face_index), expected[1])


def test_the_faces_that_uv_belongs_to(device):
    texture, uv = torch.rand(4, 4, 3, device=device), torch.rand(1, 2, 2, 2, device=device)
    for index, error in ((0, TypeError), (torch.full((1, 2, 2), 0.5), ValueError), (FACES[:2], ValueError)):
        with pytest.raises(error, match=r"^face_index: expected .*got"):
            nr.sample_texture(texture, uv, index.to(device) if isinstance(index, torch.Tensor) else index)
    for wrap in ("border", 3, np.array(["repeat", "clamp"])):
        with pytest.raises(ValueError, match=r"^wrap: expected one of repeat, clamp, mirror, or a pair of them, got"):
            nr.sample_texture(texture, uv, wrap=wrap)


@pytest.mark.parametrize("size", [1e5, 1e10, 1e19, 1e38])
def test_normals_of_large_meshes(device, size):
    """Areas overflow from 1e10 on, and their gradients were NaN."""
    corners = nr.vertices_to_faces(VERTICES[None].to(device), FACES.to(device))
    vertices = (size * VERTICES).to(device).requires_grad_()
    normals = nr.vertex_normals(vertices, FACES.to(device))
    torch.testing.assert_close(normals[0], VERTICES.to(device), rtol=0, atol=1e-6)
    direction = torch.tensor([0.3, 0.5, -0.1], device=device, requires_grad=True)
    light = nr.Light(direction=direction).two_sided(nr.vertices_to_faces(vertices[None], FACES.to(device)))
    torch.testing.assert_close(light, nr.Light(direction=direction).two_sided(corners), rtol=0, atol=1e-6)
    (normals.sum() + light.sum()).backward()
    assert vertices.grad.isfinite().all() and direction.grad.isfinite().all()


def test_no_vertices_and_no_faces(device):
    vertices = torch.zeros(2, 0, 3, device=device)
    faces = torch.zeros(0, 3, dtype=torch.int32, device=device)
    assert not nr.Renderer(8, camera_mode="look_at")(vertices, faces, mode="silhouettes").any()


def test_large_but_finite_vertices_are_no_error(device):
    """Numbers are finite although their sum overflows."""
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


HUGE = """
import itertools, sys, torch
import neural_renderer as nr
device = sys.argv[1]
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
print("huge")
"""
ABUSE = """
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


def test_numbers_of_any_kind_crash_nothing(device):
    """In a process of their own. First numbers that pass all checks, and whose products float32 cannot hold; then,
    unchecked, indices far out of range, NaN, infinity, huge and denormal numbers, forward and backward."""
    done = run_python("-c", HUGE + ABUSE, device)
    assert (done.returncode, done.stdout.split()) == (0, ["huge", "done"]), done.stderr


def test_the_farthest_depth_has_a_finite_gradient() -> None:
    vertices, faces = nr.icosphere(1)
    leaf = vertices.requires_grad_()
    camera = nr.Camera.look_at((0.0, 0.0, -2.7), viewing_angle=30)
    nr.render((leaf, faces), camera, 32, near=0.0, far=1e30, outputs="depth").depth.sum().backward()
    assert leaf.grad.isfinite().all() and leaf.grad.any()
    with pytest.raises(ValueError, match=r"near, far: expected 0 <= near < far <= 1e\+30"):
        nr.render((leaf, faces), camera, 32, near=0.0, far=1e37)
