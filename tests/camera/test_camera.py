"""Cameras: the published numbers, an independent formula for calibrated cameras, gradients, handedness, edge cases."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import neural_renderer
import neural_renderer.camera as nr
from neural_renderer.base import validate
from neural_renderer.camera import Camera
from tests.rounding import relative, rounding

HALF = math.sqrt(0.5)


def points(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, 3, generator=generator, dtype=torch.float64) - 0.5


@pytest.mark.parametrize(
    ("eye", "expected"),
    [((1, 0, 1), (-HALF, 0, HALF)), ((0, 0, -10), (1, 0, 10)), ((-1, 1, 0), (0, HALF, 1.5 * math.sqrt(2)))],
)
def test_look_at_has_the_published_values(eye, expected):
    found = nr.look_at(torch.tensor([[[1.0, 0.0, 0.0]]]), eye)
    assert found.shape == (1, 1, 3)
    # Axes are normalised cross products; then three products of numbers up to 10 are added.
    np.testing.assert_allclose(found[0, 0], expected, **rounding(16, 10))


def test_perspective_has_the_published_value():
    found = nr.perspective(torch.tensor([[[1.0, 2.0, 10.0]]]))
    np.testing.assert_allclose(found[0, 0], (math.sqrt(3) / 10, 2 * math.sqrt(3) / 10, 10), **relative(8))


def test_orthographic_scales_and_keeps_depth():
    found = nr.orthographic(torch.tensor([[1.0, 2.0, -3.0]]), torch.tensor([1.0, 2.0]))
    assert found.tolist() == [[[1, 2, -3]], [[2, 4, -3]]]


@pytest.mark.parametrize("make", [list, tuple, np.array, torch.tensor])
def test_vectors_may_be_of_any_kind(make):
    vertices = points(2, 5)
    expected = nr.look_at(vertices, torch.tensor([1.0, 2.0, -3.0], dtype=torch.float64))
    found = nr.look_at(vertices, make([1.0, 2.0, -3.0]), at=make([0, 0, 0]), up=make([0, 1, 0]))
    torch.testing.assert_close(found, expected)


def test_each_view_of_a_batch_of_three_is_its_own():
    """A cross product without a named dimension mixes the views up exactly when there are three."""
    vertices, eyes = points(3, 7), points(3, seed=1) - 2
    ups, ats = points(3, seed=2) + torch.tensor([0, 3, 0]), points(3, seed=3)
    together = nr.look_at(vertices, eyes, ats, ups)
    for i in range(3):
        torch.testing.assert_close(together[i], nr.look_at(vertices[i], eyes[i], ats[i], ups[i]))
    torch.testing.assert_close(nr.look_at(vertices[0], eyes)[1], nr.look_at(vertices[:1], eyes[1])[0])
    torch.testing.assert_close(nr.look(vertices, eyes, ats - eyes, ups), together)


def test_look_looks_along_z_by_default():
    assert nr.look(torch.tensor([[1.0, 2.0, 3.0]]), [0, 0, -1]).tolist() == [[1, 2, 4]]


def test_vertices_of_the_caller_stay_as_they_are():
    vertices = points(4)
    before = vertices.clone()
    nr.perspective(nr.look_at(vertices, [0, 0, -2]))
    assert torch.equal(vertices, before)


def test_get_points_from_angles():
    assert nr.get_points_from_angles(2, 0, 0) == (0, 0, -2)
    np.testing.assert_allclose(nr.get_points_from_angles(2, 30.0, np.int64(90)), (math.sqrt(3), 1, 0), atol=1e-12)
    tuples = nr.get_points_from_angles(2, np.float32(30), 0)
    assert type(tuples) is tuple and all(type(v) is float for v in tuples)
    assert nr.get_points_from_angles(2, torch.zeros(3), 0).shape == (3, 3)
    azimuth = torch.tensor([0.0, 0.5 * math.pi], dtype=torch.float64, requires_grad=True)
    found = nr.get_points_from_angles(2, np.zeros(1), azimuth, degrees=False)
    np.testing.assert_allclose(found.detach(), [(0, 0, -2), (2, 0, 0)], atol=1e-12)
    assert gradcheck(lambda d, e, a: nr.get_points_from_angles(d, e, a), (azimuth[1:].detach().requires_grad_(),) * 3)
    with pytest.raises(ValueError, match="azimuth: expected a batch of 1 or 2"):
        nr.get_points_from_angles(torch.ones(2), 0, torch.ones(3))


def reference_projection(vertices, K, R, t, dist, height, width):
    """One camera in numpy, written from OpenCV's documentation: project, then pixels to [-1, 1] with y up."""
    found = []
    for X in vertices:
        x, y, z = R @ X + t
        a, b = x / z, y / z
        k1, k2, p1, p2, k3 = dist
        r = math.hypot(a, b)
        radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
        a2 = a * radial + 2 * p1 * a * b + p2 * (r**2 + 2 * a**2)
        b2 = b * radial + p1 * (r**2 + 2 * b**2) + 2 * p2 * a * b
        u, v, _ = K @ (a2, b2, 1)
        found.append((u / (width / 2) - 1, 1 - v / (height / 2), z))
    return np.array(found)


def calibrated(batch: int, seed: int = 0):
    generator = np.random.default_rng(seed)
    K = np.tile([[500.0, 3.0, 310.0], [0, 480.0, 250.0], [0, 0, 1]], (batch, 1, 1))
    R = np.linalg.qr(generator.normal(size=(batch, 3, 3)))[0]
    R *= np.sign(np.linalg.det(R))[:, None, None]
    t = generator.normal(size=(batch, 1, 3)) * 0.2 + (0, 0, 3)
    dist = generator.normal(size=(batch, 5)) * 0.05
    return [torch.tensor(v, dtype=torch.float64) for v in (K, R, t, dist)]


def test_projection_agrees_with_an_independent_formula():
    vertices, (K, R, t, dist) = points(3, 6), calibrated(3)
    found = nr.projection(vertices, K, R, t, dist, orig_size=(480, 640))
    for i in range(3):
        one = (vertices[i].numpy(), K[i].numpy(), R[i].numpy(), t[i, 0].numpy(), dist[i].numpy())
        np.testing.assert_allclose(found[i], reference_projection(*one, 480, 640), rtol=1e-6)
    torch.testing.assert_close(nr.projection(vertices, K, R, t[:, 0], dist, (480, 640)), found)
    torch.testing.assert_close(Camera.projection(K, R, t, dist, (480, 640))(vertices), found)
    torch.testing.assert_close(nr.projection(vertices[0], K[0], R[0], t[0, 0], dist[0], (480, 640)), found[0])


@pytest.mark.parametrize("make", [np.array, torch.tensor, list])
def test_translations_are_rows_or_columns(make):
    K, vertices = np.diag((2.0, 2, 1)), points(4) + 3
    for t in ([0.0, 0, 3], [[0.0, 0, 3]], [[[0.0, 0, 3]]], [[0.0], [0.0], [3.0]], [[[0.0], [0.0], [3.0]]]):
        found = nr.projection(vertices, K, np.eye(3), make(t), orig_size=2)
        assert torch.equal(found.reshape(4, 3), nr.projection(vertices, K, np.eye(3), (0, 0, 3), orig_size=2))
        camera = Camera.projection(K, np.eye(3), make(t), orig_size=2)
        torch.testing.assert_close(camera(vertices), found.reshape(1, 4, 3))
    with pytest.raises(ValueError, match="t: expected shape"):
        nr.projection(vertices, K, np.eye(3), make([[[0.0, 0, 3]] * 2]))


def test_calibrations_may_have_the_shapes_of_opencv():
    """Columns, as `cv2.solvePnP` and `cv2.fisheye.calibrate` return them; four coefficients, as in many files."""
    vertices, (K, R, t, dist) = points(6), (part[0] for part in calibrated(1))
    for make, count in ((Camera.projection, 5), (Camera.fisheye, 4)):
        expected = make(K, R, t[0], dist[:count], (480, 640))(vertices)
        for shape in ((count, 1), (1, count), (1, count, 1)):
            found = make(K.numpy(), R.numpy(), t.numpy().T, dist[:count].reshape(shape).numpy(), (480, 640))
            torch.testing.assert_close(found(vertices), expected, rtol=1e-5, atol=1e-5)
    four = Camera.projection(K, R, t, dist[:4], (480, 640))
    assert torch.equal(four(vertices), Camera.projection(K, R, t, [*dist[:4], 0.0], (480, 640))(vertices))
    assert not four.is_fisheye


def test_projection_by_hand():
    K = [[100, 0, 50], [0, 100, 50], [0, 0, 1]]
    found = nr.projection(torch.tensor([[1.0, 2.0, 0.0]]), K, np.eye(3), [0, 0, 4], orig_size=100)
    np.testing.assert_allclose(found, [(0.5, -1.0, 4.0)], **rounding(16, 100))  # u = 75, v = 100: the lower border


def test_projection_has_finite_gradients_on_the_axis():
    K, _, _, dist = (v.float()[0].requires_grad_() for v in calibrated(1))
    vertices = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [1.0, 2.0, 0.0]], requires_grad=True)
    found = nr.projection(vertices, K, torch.eye(3), torch.zeros(3), dist)
    found[0].sum().backward(retain_graph=True)
    found.sum().backward()
    assert found.isfinite().all()
    assert all(v.grad.isfinite().all() for v in (vertices, K, dist))


def test_depth_zero_stays_finite_and_depth_keeps_its_sign():
    vertices = torch.tensor([[1.0, 1.0, 0.0], [1.0, 1.0, -1e-9], [3.0, 3.0, -3.0]], requires_grad=True)
    found = nr.perspective(vertices, 45.0)
    found.sum().backward()
    assert found.isfinite().all() and vertices.grad.isfinite().all()
    assert found[:, 0].sign().tolist() == [1, -1, -1]
    assert torch.equal(found[:, 2], vertices[:, 2])


@pytest.mark.parametrize("orthographic", [False, True])
def test_camera_shows_a_right_handed_world_as_it_is(orthographic):
    """From +z, +x is on the right, +y up, and an outward face is counter-clockwise; mirrored, left and right swap."""
    triangle = torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [-0.5, 0.0, 0.0]])  # outward towards +z
    camera = Camera.look_at((0, 0, 3), orthographic=orthographic)
    x, y, z = camera(triangle)[0].unbind(-1)
    assert x[0] > 0 > x[2] and y[1] > 0
    assert torch.equal(z, torch.full((3,), 3.0))
    assert (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]) > 0
    mirrored = Camera.look_at((0, 0, 3), orthographic=orthographic, mirrored=True)(triangle)[0]
    torch.testing.assert_close(mirrored, torch.stack((-x, y, z), dim=-1))
    assert camera.perspective is not orthographic and camera.mirrored is False


def test_mirrored_camera_is_the_old_view():
    vertices, eyes = points(3, 4), points(3, seed=1) - 2
    angles = torch.tensor([20.0, 30.0, 40.0], dtype=torch.float64)
    old = nr.perspective(nr.look_at(vertices, eyes), angles)
    assert torch.equal(Camera.look_at(eyes, viewing_angle=angles, mirrored=True)(vertices), old)
    old = nr.perspective(nr.look(vertices, eyes, [0.1, 0.2, 1.0], [0, 1, 0.5]))
    assert torch.equal(Camera.look(eyes, [0.1, 0.2, 1.0], [0, 1, 0.5], mirrored=True)(vertices), old)


def test_camera_batches_aspect_and_to():
    camera = Camera.look_at([[0, 0, 3.0], [3.0, 0, 0]])
    vertices = points(5).float()
    assert len(camera) == 2 and camera(vertices).shape == (2, 5, 3)
    wide, square = camera(vertices, aspect=1.5), camera(vertices)
    torch.testing.assert_close(wide * torch.tensor([1.5, 1, 1]), square)
    assert len(Camera.look_at((0, 0, 3), viewing_angle=torch.tensor([20.0, 30.0, 40.0]))) == 3
    assert Camera.look_at((0, 0, 3))(points(4, 5)).dtype == torch.float64
    assert camera.to(dtype=torch.float64).rotation.dtype == torch.float64
    with pytest.raises(ValueError, match="expected a batch of 1 or 3"):
        camera(points(3, 5).float())
    with pytest.raises(ValueError, match="aspect"):
        camera(vertices, aspect=0)
    for none in (Camera.look_at(torch.ones(0, 3)), Camera.look_at((0, 0, 3), up=torch.ones(0, 3))):
        assert len(none) == 0 and none(vertices).shape == (0, 5, 3)


def test_gradients_of_the_camera_are_right():
    vertices, eye, at, up, angle = (
        v.requires_grad_() for v in (points(1, 2), points(2) - 1, points(2) / 9, points(1)[0] + 1, 30 + points(2)[:, 0])
    )

    def view(vertices, eye, at, up, angle):
        return Camera.look_at(eye, at, up, angle)(vertices, aspect=1.25)

    def along(vertices, eye, at, up, angle):
        return Camera.look(eye, at - eye, up, orthographic=True, scale=angle / 30)(vertices)

    assert gradcheck(view, (vertices, eye, at, up, angle))
    assert gradcheck(along, (vertices, eye, at, up, angle))
    parameters = [v.requires_grad_() for v in calibrated(1)]
    assert gradcheck(lambda v, *p: Camera.projection(*p, orig_size=640)(v), (vertices, *parameters))


@pytest.mark.parametrize("scale", [1e-25, 1e-12, 1e-7, 1e7, 1e12, 1e18])
def test_views_of_any_scale(scale):
    """Their axes are those of the view of scale 1, and the same point is told by coordinates, not by their unit."""
    vertices, eye, at = points(3), torch.tensor([0.5, 1.0, -2.0]), torch.tensor([0.1, 0.2, 0.3])
    expected = nr.look_at(vertices, eye, at)
    assert torch.allclose(nr.look_at(vertices * scale, eye * scale, at * scale) / scale, expected, atol=1e-5)
    along = nr.look(vertices, eye, at - eye)
    assert torch.allclose(nr.look(vertices, eye, (at - eye) * scale), along, atol=1e-5)
    with pytest.raises(ValueError, match="eye: expected a point away"):
        nr.look_at(vertices, at * scale, at * scale * (1 + 1e-7))


def test_degenerate_views_raise_or_stay_finite():
    vertices = points(3)
    cases = {
        "eye: expected a point away": lambda: nr.look_at(vertices, [1, 1, 1], [1, 1, 1]),
        "up: expected a vector not parallel": lambda: nr.look_at(vertices, [0, 3, 0]),
        "direction: expected a vector": lambda: nr.look(vertices, [0, 3, 0], [0, 0, 0]),
        "eye: expected finite": lambda: nr.look(vertices, [0, math.nan, 0]),
    }
    for message, call in cases.items():
        with pytest.raises(ValueError, match=message):
            call()
    validate.check_values(False)
    try:
        assert all(call().isfinite().all() for call in list(cases.values())[:3])
        eye = torch.zeros(3, dtype=torch.float64, requires_grad=True)
        nr.look_at(vertices, eye).sum().backward()
        assert eye.grad.isfinite().all()
    finally:
        validate.check_values(True)


NUMBERS = {
    "look_at": lambda v, n: nr.look_at(v, [0, n, -2]),
    "look": lambda v, n: nr.look(v, [0, n, -2]),
    "perspective": lambda v, n: nr.perspective(v, 30 + n),
    "orthographic": lambda v, n: nr.orthographic(v, 1 + n),
    "projection": lambda v, n: nr.projection(v, np.eye(3), np.eye(3), [0, 0, 1], eps=1e-9 + n),
    "points": lambda v, n: nr.get_points_from_angles(2, n, 0),
    "camera": lambda v, n: Camera.look_at((0, 0, 3))(v, aspect=1 + n),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_that_are_not_finite_are_named(name):
    call, vertices = NUMBERS[name], points(4)
    call(vertices, 0.0)
    for number in (math.nan, math.inf):
        with pytest.raises(ValueError, match=r"^\w+: expected .*got"):
            call(vertices, number)
        vertices[2, 1] = number
        if name != "points":
            with pytest.raises(ValueError, match=r"^vertices: expected finite numbers, got 1 "):
                call(vertices, 0.0)
    validate.check_values(False)
    try:
        call(vertices, 0.0)
    finally:
        validate.check_values(True)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((None, None, None), TypeError, "rotation: expected a floating-point torch tensor, got NoneType"),
        ((torch.eye(3), None, None), ValueError, r"rotation: expected shape \[B, 3, 3\]"),
        ((torch.eye(3)[None], torch.zeros(2, 3), torch.zeros(1, 3)), ValueError, r"origin: expected shape \[1, 3\]"),
        ((torch.eye(3)[None], *torch.zeros(2, 1, 3), None, 1.0, torch.eye(3)[None]), TypeError, "orig_size: expected"),
        ((torch.eye(3)[None] / 0, *torch.zeros(2, 1, 3)), ValueError, "rotation: expected finite numbers, got 9 "),
        ((torch.eye(3)[None], *torch.ones(2, 1, 3) / 0), ValueError, "origin: expected finite numbers, got 3 "),
    ],
)
def test_cameras_of_wrong_parts_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        Camera(*arguments)


@pytest.mark.parametrize("dtype", [torch.int32, torch.complex64, "float32"])
def test_cameras_keep_floating_numbers(dtype):
    with pytest.raises(TypeError, match="dtype: expected a floating dtype, got"):
        Camera.look_at((0, 0, 3)).to(dtype=dtype)


def test_without_numbers_only_shapes_are_computed():
    """Tensors of torch's device "meta" go in and come out; they cannot be moved to where there are numbers."""
    vertices, eye = points(4).float().to("meta"), torch.ones(2, 3, device="meta")
    assert nr.perspective(nr.look_at(vertices, eye), torch.ones(2, device="meta")).shape == (2, 4, 3)
    assert Camera.look_at(eye)(vertices).is_meta and nr.get_points_from_angles(eye[:, 0], 0, 0).is_meta
    for call in (
        lambda v: nr.look_at(v, eye),
        lambda v: nr.perspective(v, eye[:, 0]),
        lambda v: nr.projection(v, torch.eye(3, device="meta"), np.eye(3), [0, 0, 1]),
        lambda v: Camera.look_at((0, 0, 3), viewing_angle=eye[0, 0])(v),
        lambda v: Camera.projection(np.eye(3), np.eye(3), eye, orig_size=2)(v),
    ):
        with pytest.raises(ValueError, match="expected a tensor with numbers, got one on the device"):
            call(points(4).float())


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda v: nr.look_at(v.long(), [0, 0, 1]), TypeError, "vertices: expected a floating-point"),
        (lambda v: nr.look_at(v[0], [0, 0, 1]), ValueError, r"vertices: expected shape \[B, V, 3\]"),
        (lambda v: nr.look_at(v, [0, 1]), ValueError, r"eye: expected shape \[3\] or \[B, 3\]"),
        (lambda v: nr.look_at(v, "here"), TypeError, "eye: expected numbers, got str"),
        (lambda v: nr.look_at(v, torch.ones(3).to_sparse()), TypeError, "eye: expected a dense tensor"),
        (
            lambda v: nr.look_at(v, torch.ones(3).to(torch.float8_e5m2)),
            TypeError,
            "eye: expected a floating-point tensor",
        ),
        (
            lambda v: nr.look_at(v, torch.ones(3).to(torch.complex64)),
            TypeError,
            "eye: expected a floating-point tensor",
        ),
        (lambda v: nr.look_at(v.to(torch.float8_e5m2), [0, 0, 1]), TypeError, r"vertices: .* of 16 to 64 bits, got"),
        (lambda v: nr.look_at(v.to_sparse(), [0, 0, 1]), TypeError, "vertices: expected a dense tensor"),
        (lambda v: nr.get_points_from_angles("far", 0, 0), TypeError, "distance: expected numbers, got str"),
        (lambda v: nr.get_points_from_angles(10**400, 0, 0), ValueError, r"distance: .* got one beyond 2e\+308"),
        (lambda v: nr.get_points_from_angles(torch.ones(2), 0, [10**400]), ValueError, "azimuth: expected finite"),
        (lambda v: nr.orthographic(v, 1e39), ValueError, r"scale: expected a number that float32 holds, got 1e\+39"),
        (lambda v: nr.orthographic(v, torch.tensor(1e39).double()), ValueError, "scale: expected finite numbers"),
        (
            lambda v: Camera.weak_perspective(1.0, np.eye(3), distance=1e39),
            ValueError,
            "distance: expected a number that",
        ),
        (lambda v: nr.perspective(v, 90), ValueError, r"angle: expected degrees in \(0, 90\)"),
        (lambda v: nr.perspective(v, torch.tensor([30.0, -1.0])), ValueError, "angle: expected degrees"),
        (lambda v: nr.projection(v, np.eye(4), np.eye(3), [0, 0, 1]), ValueError, "K: expected shape"),
        (lambda v: nr.projection(v, np.eye(3), np.eye(3), [0, 0, 1], orig_size=0), ValueError, "orig_size"),
    ],
)
def test_mistakes_are_named(call, error, message):
    with pytest.raises(error, match=message):
        call(points(4).float())


LENS, TURN, BACK = np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), np.eye(3), (0.0, 0.0, 3.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((LENS, TURN, BACK), r"^orig_size: expected the side or \(height, width\) .*got None"),
        ((LENS, TURN, BACK, None, (4, 0)), r"^orig_size: expected positive"),
        ((2 * LENS, TURN, BACK, None, 8), r"^K: expected the third row \(0, 0, 1\), got \(0.0, 0.0, 2.0\)"),
        (
            (np.stack((LENS, LENS[[2, 1, 0]])), TURN, BACK, None, 8),
            r"^K: expected the third row \(0, 0, 1\), got \(8.0, 0.0, 4.0\)",
        ),
        ((LENS, 2 * TURN, BACK, None, 8), r"^R: expected a rotation matrix \(R Rᵀ = I\), got a deviation of 3"),
        ((LENS, np.stack((TURN, 0.9 * TURN)), BACK, None, 8), r"^R: expected a rotation matrix .*deviation of 0.19"),
        ((LENS, np.diag((1, 1, -1)), BACK, None, 8), r"^R: expected a rotation matrix, got a reflection"),
        ((LENS, TURN, (0.0, 3.0), None, 8), r"^t: expected shape \[3\]"),
        ((LENS, TURN, [[0.0], [3.0]], None, 8), r"^t: expected shape \[3\]"),
        ((LENS, TURN, [[[0.0, 3.0]]], None, 8), r"^t: expected shape \[3\], \[B, 3\] or \[B, 1, 3\]"),
        ((LENS, TURN, BACK, (0.1, 0.2, 0.3), 8), r"^dist_coeffs: expected shape \[5\]"),
        ((LENS, TURN, BACK, np.zeros((8, 1)), 8), r"^dist_coeffs: expected shape \[5\]"),
    ],
)
def test_calibrations_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Camera.projection(*arguments)


def test_what_cameras_check_the_old_function_takes():
    """The first packages' `projection` has a default size and takes any matrix: programs count on both."""
    vertices = points(4)
    expected = nr.projection(vertices, LENS, TURN, BACK, orig_size=1024)
    assert torch.equal(nr.projection(vertices, LENS, TURN, BACK), expected)
    turned = nr.projection(vertices, LENS, -2 * TURN, BACK, orig_size=8)
    torch.testing.assert_close(turned, nr.projection(-2 * vertices, LENS, TURN, BACK, orig_size=8))


def test_rotations_may_be_rounded():
    """To three digits, or to bfloat16."""
    R = torch.linalg.qr(points(20, 3))[0]
    R = R * torch.linalg.det(R)[:, None, None]
    for rounded in ((1000 * R).round() / 1000, R.bfloat16().double()):
        assert (
            len(Camera.projection(LENS, rounded, BACK, orig_size=8)) == len(Camera.weak_perspective(1.0, rounded)) == 20
        )
    for wrong, message in ((2 * R, "a deviation of 3"), (-R, "a reflection")):
        with pytest.raises(ValueError, match=f"^R: expected a rotation matrix.*{message}"):
            Camera.weak_perspective(1.0, wrong)
    for scale in (0.0, -1.0, torch.tensor([1.0, 0.0])):
        with pytest.raises(ValueError, match=r"^scale: expected a number above 0"):
            Camera.weak_perspective(scale, R[:2])
    validate.check_values(False)
    try:
        assert len(Camera.projection(2 * LENS, -2 * R, BACK, orig_size=8)) == 20
    finally:
        validate.check_values(True)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_computed_in_float32(dtype):
    """Beside the camera neither 1 / z nor r⁶ fits into float16."""
    near = torch.tensor([[1.0, 2.0, -3.0], [30.0, -20.0, -2.998], [0.5, 0.0, 0.0]]).to(dtype)
    dist = (0.1, -0.2, 0.01, 0.02, 0.3)
    cameras = [Camera.projection(LENS, TURN, BACK, dist, 8), Camera.projection(LENS, TURN, BACK, None, 8)]
    for camera in [*cameras, Camera.look_at((0, 0, -3.0)), Camera.look_at((0, 0, 3.0), orthographic=True)]:
        found = camera(near)
        assert found.dtype == torch.float32 and found.isfinite().all()
        assert torch.equal(found, camera(near.float()))
    inside = points(5).to(dtype)
    for lens in (dist, None):
        found = nr.projection(inside, LENS, TURN, BACK, lens, 8)
        assert found.dtype == dtype
        exact = nr.projection(inside.double(), LENS, TURN, BACK, lens, 8)
        # Vertices, R X + t and the results are rounded to the type; pixels are 8 times x, over 4, and depth is 3.
        torch.testing.assert_close(found.double(), exact, rtol=0, atol=8 * torch.finfo(dtype).eps)


def test_a_view_alone_is_the_same_among_others():
    """To the bit: nothing is summed in an order that depends on the batch."""
    eyes, ats, ups = 3 * points(33), points(33, seed=1) / 9, points(33, seed=2) + torch.tensor([0, 2, 0])
    for kind in (torch.float32, torch.float64):
        eye, at, up = (v.to(kind) for v in (eyes, ats, ups))
        together = Camera.look_at(eye, at, up, eye.new_tensor(range(10, 43)))(points(7).to(kind))
        for i in range(33):
            alone = Camera.look_at(eye[i], at[i], up[i], eye.new_tensor(10 + i))(points(7).to(kind))
            assert torch.equal(together[i], alone[0])


@pytest.mark.parametrize("far", [1e19, 1e30, 1e38])
def test_eyes_may_be_far_away(far):
    near, away = Camera.look_at((1.0, 2.0, 3.0)), Camera.look_at((far, 2 * far, 3 * far))
    torch.testing.assert_close(near.rotation, away.rotation)


def test_the_checks_leave_torch_func_alone():
    vertices = points(2, 4)
    found = torch.func.grad(lambda v: nr.perspective(nr.look_at(v, [0, 1, -2])).square().sum())(vertices)
    leaf = vertices.clone().requires_grad_()
    nr.perspective(nr.look_at(leaf, [0, 1, -2])).square().sum().backward()
    torch.testing.assert_close(found, leaf.grad)


@pytest.mark.skipif(
    tuple(map(int, torch.__version__.split(".")[:2])) < (2, 7), reason="torch 2.6 compiles no frozen dataclasses"
)
def test_everything_compiles_in_one_graph():
    K, R, t, dist = calibrated(2)

    def render(vertices, eye):
        seen = nr.perspective(nr.look_at(vertices, eye), 30.0)
        camera = Camera.look_at(eye, viewing_angle=torch.full((2,), 25.0))
        photo = Camera.projection(K, R, t, dist, (480, 640))
        return seen, camera(vertices, aspect=2.0), photo(vertices), nr.look(vertices, [0, 0, -3])

    vertices, eye = points(2, 4), points(2, seed=1) - 2
    compiled = torch.compile(render, fullgraph=True, backend="eager")
    torch.testing.assert_close(compiled(vertices, eye), render(vertices, eye))
    camera = Camera.look_at(eye)
    again = torch.compile(lambda v: camera(v), fullgraph=True, backend="eager")
    torch.testing.assert_close(again(vertices), camera(vertices))


def test_weak_perspective():
    """The formula, with x right and y down, and a depth that the picture does not depend on."""
    generator = torch.Generator().manual_seed(0)
    points = torch.randn(2, 5, 3, generator=generator, dtype=torch.float64)
    R = torch.linalg.qr(torch.randn(2, 3, 3, generator=generator, dtype=torch.float64))[0]
    R = R * torch.linalg.det(R)[:, None, None]
    scale, shift = torch.tensor([0.5, 0.9]).double(), torch.tensor([[0.1, -0.2], [0.0, 0.3]]).double()
    turned = points @ R.transpose(1, 2)
    screen = nr.Camera.weak_perspective(scale, R, shift, distance=7)(points)
    across = scale[:, None, None] * turned[..., :2] + shift[:, None]
    expected = torch.cat((across * torch.tensor([1.0, -1.0]).double(), turned[..., 2:] + 7), -1)
    torch.testing.assert_close(screen, expected)
    leaves = [x.clone().requires_grad_() for x in (scale, R, shift)]
    nr.Camera.weak_perspective(*leaves)(points).square().sum().backward()
    assert all((leaf.grad != 0).all() for leaf in leaves)
    with pytest.raises(ValueError, match=r"shift: expected shape \[2\] or \[B, 2\]"):
        nr.Camera.weak_perspective(1.0, R, (0.0, 0.0, 0.0))


def test_repr_is_one_line():
    K, eye = torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), torch.tensor([[0.0, 1, 3], [0, 2, 3]])
    assert repr(nr.Camera.look_at(eye, viewing_angle=20)) == "Camera(2 cameras, viewing angle 20, cpu)"
    assert repr(nr.Camera.look_at(eye[0], viewing_angle=K[0, 0])) == "Camera(1 camera, viewing angles, cpu)"
    assert repr(nr.Camera.look(eye[:1], (0, 0, 1.0), orthographic=True, mirrored=True)) == (
        "Camera(1 camera, orthographic, mirrored, cpu)"
    )
    pose = (K, torch.eye(3), [0.0, 0.0, 3.0])
    assert repr(nr.Camera.projection(*pose, orig_size=(48, 64))) == "Camera(1 camera, K of 48 × 64, cpu)"
    assert repr(nr.Camera.fisheye(*pose, [0.1, 0, 0, 0], orig_size=48)) == "Camera(1 camera, fisheye of 48 × 48, cpu)"


EYES = torch.tensor([[0.3, 1.2, -2.0], [1.0, -0.5, 2.5]], dtype=torch.float64)


def cameras_at_the_same_places() -> dict[str, Camera]:
    """Cameras at `EYES` that look at the origin, in all forms that the class stores."""
    camera = Camera.look_at(EYES)
    shift = torch.tensor([[0.2, -0.1, 0.4]], dtype=torch.float64).expand(2, 3)
    moved = EYES + torch.einsum("bij,bi->bj", camera.rotation, shift)
    calibrated = camera.with_K((60, 80))
    return {
        "angle": camera,
        "orthographic": Camera.look_at(EYES, orthographic=True),
        "mirrored": Camera.look_at(EYES, mirrored=True),
        "K": calibrated,
        "both parts": Camera(camera.rotation, moved, shift, viewing_angle=30.0),
        "matrix": Camera.from_matrix(
            world_to_camera=torch.cat((calibrated.rotation, calibrated.translation[..., None]), 2), fov=60
        ),
    }


@pytest.mark.parametrize("form", ["angle", "orthographic", "mirrored", "K", "both parts", "matrix"])
def test_position_forward_and_up_do_not_depend_on_the_form(form):
    camera = cameras_at_the_same_places()[form]
    forward = torch.nn.functional.normalize(-EYES, dim=1)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, EYES.new_tensor([[0.0, 1.0, 0.0]])), dim=1)
    close = {"rtol": 0.0, "atol": 1e-14}
    torch.testing.assert_close(camera.position, EYES, **close)
    torch.testing.assert_close(camera.forward, forward, **close)
    torch.testing.assert_close(camera.up, torch.linalg.cross(right, forward), **close)
    torch.testing.assert_close(camera.axes[:, 1:], torch.stack((camera.up, camera.forward), 1), **close)
    if form != "mirrored":
        torch.testing.assert_close(camera.axes[:, 0], right, **close)


def test_origin_and_translation_count_for_cameras_with_an_angle():
    """Any split of a position into the two attributes gives the same projection and the same image."""
    forms = cameras_at_the_same_places()
    vertices = points(7)
    torch.testing.assert_close(forms["both parts"](vertices), forms["angle"](vertices))
    pixels, depth = forms["both parts"].project(vertices, 64)
    torch.testing.assert_close(forms["both parts"].unproject(pixels, depth, 64), vertices.expand(2, -1, -1))
    mesh = neural_renderer.Mesh.icosphere(1)
    images = [neural_renderer.render(mesh, forms[name], 32, outputs="depth").depth for name in ("both parts", "angle")]
    torch.testing.assert_close(*images, rtol=0, atol=1e-5)


def test_up_follows_the_rows_of_images_that_K_turns_upside_down():
    K = [[50.0, 0.0, 32.0], [0.0, -50.0, 32.0], [0.0, 0.0, 1.0]]
    camera = Camera.projection(K, torch.eye(3), (0.0, 0.0, 3.0), orig_size=64)
    above = camera.project(camera.up[None])[0] - camera.project(torch.zeros(1, 1, 3))[0]
    assert camera.up.tolist() == [[0, 1, 0]] and float(above[0, 0, 1]) < 0


def test_position_and_up_are_differentiable():
    K = torch.tensor([[50.0, 0.0, 32.0], [0.0, 50.0, 32.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    rotation = Camera.look_at(EYES).rotation.requires_grad_()
    shift = points(2).requires_grad_()

    def parts(rotation, shift):
        camera = Camera(rotation, shift, 2 * shift, K=K.expand(2, 3, 3), orig_size=(64, 64))
        return camera.position, camera.forward, camera.up

    assert gradcheck(parts, (rotation, shift))


def test_fov_is_the_whole_angle():
    camera = Camera.look_at((0.0, 0.0, 3.0), fov=50)
    assert camera.viewing_angle == 25 and camera.fov == 50
    assert Camera.look((0.0, 0.0, 3.0), (0.0, 0.0, -1.0), fov=torch.tensor([50.0, 70.0])).viewing_angle.tolist() == [
        25,
        35,
    ]
    assert Camera.look_at((0.0, 0.0, 3.0), orthographic=True).fov is None
    torch.testing.assert_close(camera.with_K((64, 48)).fov, torch.tensor([50.0]))
    with pytest.raises(ValueError, match="fov: expected either this or viewing_angle, got both"):
        Camera.look_at((0.0, 0.0, 3.0), fov=50, viewing_angle=25)
    with pytest.raises(ValueError, match=r"fov: expected degrees in \(0, 180\), the whole field of view, got 180"):
        Camera.look_at((0.0, 0.0, 3.0), fov=180)


@pytest.mark.parametrize("form", ["angle", "orthographic", "K"])
def test_zoomed_enlarges_images_around_the_principal_point(form):
    camera, vertices = cameras_at_the_same_places()[form], points(5)
    for factor in (1.5, torch.tensor(1.5, dtype=torch.float64), torch.tensor([1.5, 0.5], dtype=torch.float64)):
        expected = camera(vertices)[..., :2] * torch.as_tensor(factor).reshape(-1, 1, 1)
        torch.testing.assert_close(camera.zoomed(factor)(vertices)[..., :2], expected)
    with pytest.raises(ValueError, match="factor: expected a number above 0, got 0"):
        camera.zoomed(0)


def test_slices_compile_once():
    """Once for the first numbers, and once for all others: torch takes a number for a constant until it changes."""
    graphs = []

    def count(graph, _):
        graphs.append(graph)
        return graph.forward

    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 30.0, torch.arange(0.0, 360.0, 30.0)))
    torch._dynamo.reset()
    compiled = torch.compile(lambda first, end: 2 * camera[first:end].origin, backend=count, fullgraph=True)
    for first in range(0, 12, 2):
        assert torch.equal(compiled(first, first + 2), 2 * camera.origin[first : first + 2])
    assert len(graphs) == 2


@pytest.mark.parametrize("form", ["angle", "scale", "K"])
def test_what_is_kept_of_a_camera_follows_its_tensors(form):
    """Seen in inference mode, changed in place, then moved by a gradient or a tangent, it draws as a new camera."""
    vertices, faces = neural_renderer.icosphere(1)
    options = {"angle": {}, "scale": {"orthographic": True, "scale": 0.8}, "K": {}}[form]
    camera = Camera.look_at(torch.tensor([0.3, 0.2, -3.0]), **options)
    if form == "K":
        intrinsics = torch.tensor([[[40.0, 0.0, 15.0], [0.0, 40.0, 17.0], [0.0, 0.0, 1.0]]])
        camera = Camera(camera.rotation, camera.origin, torch.zeros(1, 3), K=intrinsics, orig_size=(32, 32))

    def draw(camera):
        return neural_renderer.render((vertices, faces), camera, 16, outputs=("rgb",), gradient="edge").rgb

    with torch.inference_mode():
        draw(camera)
    first = draw(camera)
    camera.translation.add_(torch.tensor([0.1, -0.2, 0.3]))
    moved = draw(camera)
    assert not torch.equal(moved, first)
    assert torch.equal(moved, draw(replace(camera)))
    for change in (camera.translation.numpy(), camera.translation.data):  # which torch does not count
        change += 0.05
        assert not torch.equal(draw(camera), moved)
        moved = draw(camera)
        assert torch.equal(moved, draw(replace(camera)))
    camera.translation.requires_grad_()
    assert torch.autograd.grad(draw(camera).square().sum(), camera.translation)[0].any()
    camera.translation.requires_grad_(False)
    change = torch.func.jvp(lambda t: draw(replace(camera, translation=t)), (camera.translation,), (torch.ones(1, 3),))
    assert torch.equal(change[0], moved) and change[1].any()
    assert torch.equal(draw(camera), moved)
