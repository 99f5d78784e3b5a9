"""Matrices of other programs, pixels and depth, cameras of a batch: against OpenCV and the definition of clip space."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import neural_renderer as nr
from neural_renderer import Camera

AXES = {"opencv": (1, 1, 1), "opengl": (1, -1, -1), "blender": (1, -1, -1), "pytorch3d": (-1, -1, 1)}
DISTORTION = (-0.2, 0.05, 0.003, -0.002, 0.01)


@pytest.fixture(autouse=True)
def in_float64():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def frames(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotations near OpenCV's, and translations that put the unit cube in front of the camera."""
    generator = torch.Generator().manual_seed(0)
    R = torch.linalg.matrix_exp(0.4 * (a := torch.randn(count, 3, 3, generator=generator)) - 0.4 * a.transpose(1, 2))
    return R, 0.3 * torch.randn(count, 3, generator=generator) + torch.tensor([0.0, 0.0, 4.0])


def cloud(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, 3, generator=torch.Generator().manual_seed(1)) - 0.5


def intrinsics() -> torch.Tensor:
    return torch.tensor([[500.0, 3.0, 310.0], [0.0, 480.0, 250.0], [0.0, 0.0, 1.0]])


def cameras(kind: str) -> Camera:
    R, t = frames(3)
    if kind == "angle":
        return Camera.look_at(-t, viewing_angle=torch.tensor([20.0, 25.0, 30.0]))
    if kind == "mirrored":
        return Camera.look_at(-t, viewing_angle=20, mirrored=True)
    if kind == "orthographic":
        return Camera.look_at(-t, orthographic=True, scale=torch.tensor([0.5, 0.7, 0.9]))
    distortion = torch.tensor(DISTORTION) if kind == "distorted" else None
    return Camera.projection(intrinsics(), R, t, distortion, orig_size=(480, 640))


@pytest.mark.parametrize("distortion", [None, DISTORTION], ids=["pinhole", "distorted"])
def test_pixels_are_those_of_opencv(distortion) -> None:
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    (R, t), points = frames(3), cloud(3, 20)
    coefficients = None if distortion is None else torch.tensor(distortion)
    K = intrinsics()
    K[0, 1] = 0  # OpenCV has no skew
    camera = Camera.projection(K, R, t, coefficients, orig_size=(480, 640))
    pixels, depth = camera.project(points)
    for i in range(3):
        given = np.zeros(5) if distortion is None else np.array(distortion)
        rvec, _ = cv2.Rodrigues(R[i].numpy())
        expected, _ = cv2.projectPoints(points[i].numpy(), rvec, t[i].numpy(), K.numpy(), given)
        # Depths are near 4, where the 1e-9 that `projection` adds moves a pixel by at most 700 · 1e-9 / 4.
        np.testing.assert_allclose(pixels[i], expected[:, 0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(depth[i], (points[i] @ R[i].T + t[i])[:, 2], rtol=1e-12)
        back = camera[i].unproject(torch.from_numpy(expected[:, 0]), depth[i])
        torch.testing.assert_close(back[0], points[i], rtol=0, atol=1e-7)  # 1e-6 pixels · depth 4 / 500, and a margin


@pytest.mark.parametrize("kind", ["angle", "mirrored", "orthographic", "K", "distorted"])
@pytest.mark.parametrize("size", [(48, 64), 100])
def test_unproject_inverts_project(kind, size) -> None:
    camera, points = cameras(kind), cloud(3, 20)
    pixels, depth = camera.project(points, size)
    torch.testing.assert_close(camera.unproject(pixels, depth, size), points, rtol=0, atol=1e-8)
    alone = camera[1].unproject(pixels[1], depth[1], size)
    torch.testing.assert_close(alone[0], points[1], rtol=0, atol=1e-8)


def test_points_may_be_arrays_or_lists() -> None:
    camera, points = cameras("K"), cloud(3, 20)
    pixels, depth = camera.project(points)
    for convert in (np.asarray, torch.Tensor.tolist):
        found = camera.project(convert(points))
        assert torch.equal(found[0], pixels) and torch.equal(found[1], depth)
        assert torch.equal(camera.unproject(convert(pixels), convert(depth)), camera.unproject(pixels, depth))


def test_pixels_are_where_the_picture_shows_the_point() -> None:
    """A small white face around the point covers the pixel that `project` names, and its depth is there."""
    camera = Camera.look_at((0.3, 1.0, -2.5), viewing_angle=25)
    point = torch.tensor([[0.2, 0.3, 0.1]])
    corner = torch.tensor([[0.05, 0.0, 0.0], [0.0, 0.05, 0.0], [-0.05, -0.05, 0.0]])
    (pixel,), depth = camera.project(point, (60, 90))[0][0], camera.project(point, (60, 90))[1]
    images = nr.render((point + corner, torch.tensor([[0, 1, 2]])), camera, (60, 90), outputs=("alpha", "depth"))
    column, row = (int(v) for v in pixel)
    assert images.alpha[0, row, column] == 1 and images.alpha.sum() < 60
    assert abs(float(images.depth[0, row, column] - depth[0, 0])) < 0.05


def test_gradients_of_unproject() -> None:
    camera, points = cameras("distorted"), cloud(3, 2)
    pixels, depth = camera.project(points)

    def found(pixels, depth, K, coefficients):
        R, t = frames(3)
        return Camera.projection(K, R, t, coefficients, orig_size=(480, 640)).unproject(pixels, depth)

    leaves = (pixels, depth, intrinsics(), torch.tensor(DISTORTION))
    assert gradcheck(found, tuple(leaf.detach().clone().requires_grad_() for leaf in leaves))


@pytest.mark.parametrize("convention", AXES)
@pytest.mark.parametrize("name", ["world_to_camera", "camera_to_world"])
def test_matrices_of_each_convention_are_one_camera(convention, name) -> None:
    (R, t), points = frames(3), cloud(20)
    matrix = torch.eye(4).repeat(3, 1, 1)
    signs = torch.tensor(AXES[convention], dtype=torch.float64)
    matrix[:, :3, :3], matrix[:, :3, 3] = R * signs[:, None], t * signs
    if name == "camera_to_world":
        matrix = torch.linalg.inv(matrix)
    if convention == "pytorch3d":
        matrix = matrix.transpose(1, 2)  # for rows of points
    expected = Camera.projection(intrinsics(), R, t, orig_size=(480, 640))
    same = {name: matrix, "convention": convention}
    found = Camera.from_matrix(**same, K=intrinsics(), orig_size=(480, 640))
    torch.testing.assert_close(found(points), expected(points))
    x, y, z = (points @ R.transpose(1, 2) + t[:, None]).unbind(-1)
    seen = Camera.from_matrix(**same, viewing_angle=25.0)(points)
    width = math.tan(math.radians(25))
    torch.testing.assert_close(seen, torch.stack((x / z / width, -y / z / width, z), -1))
    flat = Camera.from_matrix(**same, orthographic=True, scale=0.5)(points, aspect=2.0)
    torch.testing.assert_close(flat, torch.stack((x / 4, -y / 2, z), -1))


def perspective_matrix(f: float, aspect: float, near: float, far: float) -> torch.Tensor:
    """gluPerspective's matrix, from its documentation; f is the cotangent of half the field of view."""
    a, b = (far + near) / (near - far), 2 * far * near / (near - far)
    return torch.tensor([[f / aspect, 0, 0, 0], [0, f, 0, 0], [0, 0, a, b], [0, 0, -1, 0]])


@pytest.mark.parametrize("mirror", [False, True])
def test_clip_matrices(mirror) -> None:
    R, t = frames(3)
    view = torch.eye(4).repeat(3, 1, 1)
    signs = torch.tensor([1.0, -1.0, -1.0])
    view[:, :3, :3], view[:, :3, 3] = R * signs[:, None], t * signs
    projection = perspective_matrix(2.5, 1.5, 0.1, 50)
    projection[0, 2], projection[0, 1] = 0.2, 0.05  # off the centre, and sheared
    projection[0] *= -1 if mirror else 1
    matrix, points = projection @ view, cloud(20)
    clip = (matrix[:, None] @ torch.cat((points, torch.ones(20, 1)), 1)[..., None])[..., 0]
    camera = Camera.from_clip(matrix)
    found = camera(points)
    torch.testing.assert_close(found[..., :2], clip[..., :2] / clip[..., 3:])
    torch.testing.assert_close(found[..., 2], clip[..., 3])
    assert camera.mirrored == mirror
    torch.testing.assert_close(Camera.from_clip(7 * matrix)(points), found)
    torch.testing.assert_close(Camera.from_clip(matrix[1])(points)[0], found[1])
    unit = torch.tensor([1e-7, 1e-7, 1e-7, 1.0])  # of the world; and a camera far away
    torch.testing.assert_close(Camera.from_clip(matrix * unit)(1e7 * points)[..., :2], found[..., :2])
    away = matrix.double() @ (EYE.double() + torch.nn.functional.pad(torch.full((3, 1), -1e9), (3, 0, 0, 1)))
    torch.testing.assert_close(Camera.from_clip(away)(points.double() + 1e9), found.double(), rtol=1e-4, atol=1e-5)
    leaf = matrix.clone().requires_grad_()
    assert gradcheck(lambda m: Camera.from_clip(m)(points[:2]), (leaf,))


def test_a_clip_matrix_draws_the_same_picture_as_look_at() -> None:
    camera = Camera.look_at((1.0, 1.5, -2.5), viewing_angle=30)
    view = torch.eye(4)
    view[:3, :3] = camera.rotation[0] * torch.tensor([1.0, 1.0, -1.0])[:, None]
    view[:3, 3] = -view[:3, :3] @ camera.origin[0]
    matrix = perspective_matrix(1 / math.tan(math.radians(30)), 1.5, 0.1, 100) @ view
    mesh = nr.Mesh.icosphere(2)
    with torch.no_grad():
        expected, found = (nr.render(mesh, c, (32, 48)).rgb for c in (camera, Camera.from_clip(matrix)))
    # Both round; a pixel whose centre lies on an edge may show either face.
    assert ((expected - found).abs() > 1e-3).float().mean() < 1e-3


@pytest.mark.parametrize("kind", ["angle", "mirrored", "orthographic", "K", "distorted"])
def test_cameras_of_a_batch(kind) -> None:
    camera, points = cameras(kind), cloud(20)
    expected = camera(points)
    chosen = torch.tensor([2, 0])
    choices = {0: [0], -1: [2]} | {2: [2]}
    for index, rows in [
        *choices.items(),
        (slice(1, None), [1, 2]),
        (slice(None, None, -1), [2, 1, 0]),
        (range(2), [0, 1]),
        ([0, 2], [0, 2]),
        (chosen, [2, 0]),
    ]:
        assert torch.equal(camera[index](points), expected[rows])
    assert torch.equal(camera[torch.tensor([True, False, True])](points), expected[[0, 2]])
    assert len(list(camera)) == 3 and all(len(one) == 1 for one in camera)
    assert torch.equal(Camera.cat(list(camera))(points), expected)
    assert torch.equal(Camera.cat([camera[1:], camera[0]])(points), expected[[1, 2, 0]])
    for index in (3, -4, 1.5, "a", None, True, (0, 1)):
        with pytest.raises((IndexError, TypeError), match="index: expected"):
            camera[index]


def test_cameras_put_together() -> None:
    points = cloud(5)
    wide, narrow = Camera.look_at((0, 0, -3), viewing_angle=40), Camera.look_at((0, 1, -3), viewing_angle=20)
    assert isinstance(Camera.cat([wide, wide]).viewing_angle, (int, float))
    torch.testing.assert_close(Camera.cat([wide, narrow])(points), torch.cat((wide(points), narrow(points))))
    half = intrinsics() * torch.tensor([[0.5], [0.5], [1.0]])
    large, small = cameras("distorted"), Camera.projection(half, *frames(1), orig_size=(250, 330))
    both = Camera.cat([large, small])
    assert both.orig_size == (480, 640)
    torch.testing.assert_close(both(points), torch.cat((large(points), small(points))))
    for wrong, error, sentence in [
        ([], ValueError, "cameras: expected at least one"),
        ([wide, 3], TypeError, "cameras: expected a list of Camera"),
        (wide, TypeError, "cameras: expected a list of Camera"),
        ([wide, large], ValueError, "cameras: expected one kind of lens, got K and viewing_angle"),
        ([wide, cameras("mirrored")], ValueError, "cameras: expected all mirrored or none"),
    ]:
        with pytest.raises(error, match=sentence):
            Camera.cat(wrong)


EYE = torch.eye(4)
SCALED = torch.diag(torch.tensor([2.0, 2.0, 2.0, 1.0]))
MOVED = torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 3, 1]])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: Camera.from_matrix(world_to_camera=EYE), "viewing_angle: expected one lens"),
        (lambda: Camera.from_matrix(viewing_angle=30), "world_to_camera: expected either this or .*, got none"),
        (
            lambda: Camera.from_matrix(world_to_camera=EYE, camera_to_world=EYE, viewing_angle=30),
            "world_to_camera: expected either this or .*, got both",
        ),
        (
            lambda: Camera.from_matrix(world_to_camera=EYE, viewing_angle=30, convention="maya"),
            "convention: expected one of 'opencv', 'opengl', 'blender', 'pytorch3d', got 'maya'",
        ),
        (lambda: Camera.from_matrix(camera_to_world=SCALED, viewing_angle=30), "camera_to_world: expected a rotation"),
        (lambda: Camera.from_matrix(world_to_camera=MOVED, viewing_angle=30), r"the last row \(0, 0, 0, 1\)"),
        (
            lambda: Camera.from_matrix(world_to_camera=MOVED.T, viewing_angle=30, convention="pytorch3d"),
            r"the last column \(0, 0, 0, 1\)",
        ),
        (lambda: Camera.from_matrix(world_to_camera=EYE[:2], viewing_angle=30), r"expected shape \[3, 4\] or \[4, 4\]"),
        (lambda: Camera.from_clip(EYE), "matrix: expected a perspective projection"),
        (lambda: Camera.from_clip(EYE[:3]), r"matrix: expected shape \[4, 4\]"),
        (lambda: Camera.from_clip(EYE[[0, 3, 2, 2]]), "matrix: expected independent rows"),
        (lambda: Camera.look_at((0, 0, -3)).project(EYE[:, :3]), "size: expected the side"),
        (lambda: Camera.look_at((0, 0, -3)).project(EYE, 64), r"points: expected shape \[V, 3\]"),
        (lambda: Camera.look_at((0, 0, -3)).project(EYE[:, :3], (0, 3)), "size: expected positive"),
        (lambda: Camera.look_at((0, 0, -3)).unproject(EYE, EYE[0], 64), r"pixels: expected shape \[V, 2\]"),
        (lambda: Camera.look_at((0, 0, -3)).unproject(EYE[:, :2], EYE[0, :3], 64), r"depth: expected shape \[4\]"),
    ],
)
def test_errors(call, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        call()
