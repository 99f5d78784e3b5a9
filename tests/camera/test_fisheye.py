"""Fisheye cameras, against OpenCV's own functions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import neural_renderer as nr
from neural_renderer import Camera

COEFFICIENTS = (0.05, -0.012, 0.004, -0.0007)
K = np.array([[300.0, 0.0, 310.0], [0.0, 280.0, 250.0], [0.0, 0.0, 1.0]])
TURN, SHIFT = np.array([0.2, -0.3, 0.1]), np.array([0.1, -0.2, 0.5])
R = cv2.Rodrigues(TURN)[0]


def seen(farthest: float = 6.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Points before the camera up to the tangent ``farthest`` of their angle, in its coordinates and in the world."""
    generator = torch.Generator().manual_seed(0)
    u, v, z = torch.rand(3, 60, generator=generator, dtype=torch.float64)
    points = torch.stack((farthest * (u - 0.5), farthest * (v - 0.5), torch.ones_like(z)), 1) * (z + 0.5)[:, None]
    return points, (points - torch.from_numpy(SHIFT)) @ torch.from_numpy(R)


def lens(coefficients=COEFFICIENTS, dtype=torch.float64) -> Camera:
    given = (torch.tensor(np.array(part), dtype=dtype) for part in (K, R, SHIFT, coefficients))
    return Camera.fisheye(*given, orig_size=(480, 640))


@pytest.mark.parametrize("coefficients", [COEFFICIENTS, (0.0, 0.0, 0.0, 0.0)])
def test_pixels_are_those_of_opencv(coefficients) -> None:
    (inside, points), camera = seen(), lens(coefficients)
    expected, _ = cv2.fisheye.projectPoints(points.numpy()[:, None], TURN, SHIFT, K, np.array(coefficients))
    pixels, depth = camera.project(points)
    np.testing.assert_allclose(pixels[0], expected[:, 0], rtol=0, atol=1e-9)  # some roundings of 1000 in float64
    torch.testing.assert_close(depth[0], inside[:, 2])
    found = camera.unproject(pixels, depth)
    # Towards 90° a change of the pixel by 1e-12 moves the point by 1 + tan² as much.
    torch.testing.assert_close(found[0], points, rtol=1e-9, atol=1e-9)
    undone = cv2.fisheye.undistortPoints(expected, K, np.array(coefficients), criteria=(3, 50, 1e-14))
    np.testing.assert_allclose(undone[:, 0], inside[:, :2] / inside[:, 2:], rtol=0, atol=1e-8)
    torch.testing.assert_close(camera.project(points, (240, 320))[0], pixels / 2)


def test_a_lens_without_coefficients_is_equidistant() -> None:
    points = seen()[1]
    plain = Camera.fisheye(K, R, SHIFT, orig_size=(480, 640)).to(dtype=torch.float64)
    torch.testing.assert_close(plain(points), lens((0.0,) * 4)(points), rtol=1e-6, atol=1e-6)
    camera = Camera.fisheye(torch.eye(3), torch.eye(3), torch.zeros(3), orig_size=2)
    angles = torch.tensor([0.0, 0.4, 1.2, 2.5])  # the last one is behind the camera
    pixels, _ = camera.project(torch.stack((angles.sin(), torch.zeros(4), angles.cos()), 1))
    torch.testing.assert_close(pixels[0], torch.stack((angles, torch.zeros(4)), 1))


def test_gradients() -> None:
    points, camera = seen(4.0)[1][:3], lens()
    pixels, depth = camera.project(points)
    dist = torch.tensor(COEFFICIENTS, dtype=torch.float64)
    leaves = [part.clone().requires_grad_() for part in (points, dist)]

    def project(points, dist):
        return Camera.fisheye(camera.K, camera.rotation, camera.translation, dist, (480, 640))(points)

    def unproject(pixels, depth, dist):
        own = Camera.fisheye(camera.K, camera.rotation, camera.translation, dist, (480, 640))
        return own.unproject(pixels, depth)

    assert gradcheck(project, leaves)
    assert gradcheck(unproject, [part.clone().requires_grad_() for part in (pixels, depth, dist)])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_axis_is_like_a_pinhole(dtype) -> None:
    """Its Jacobian is that of x / z; values and gradients are finite everywhere."""
    camera = Camera.fisheye(torch.eye(3), torch.eye(3), torch.zeros(3), COEFFICIENTS, orig_size=2)
    points = torch.tensor([[0.0, 0, 2], [0, 0, 0], [0, 0, -1], [1e30, 1, 0], [1e-30, 0, 1e-30]], dtype=dtype)
    points.requires_grad_()
    screen = camera(points)[0]
    jacobian = torch.autograd.grad(screen[0, 0], points, retain_graph=True)[0]
    torch.testing.assert_close(jacobian[0], torch.tensor([0.5, 0, 0], dtype=dtype))  # 1 / z
    gradient = torch.autograd.grad(screen.sum(), points)[0]
    assert screen.isfinite().all() and gradient.isfinite().all()
    pixels = torch.tensor([[0.0, 0.0]], dtype=dtype, requires_grad=True)
    camera.unproject(pixels, torch.ones(1, dtype=dtype)).sum().backward()
    torch.testing.assert_close(pixels.grad, torch.ones(1, 2, dtype=dtype))


def test_a_render_shows_the_surface_at_its_pixels() -> None:
    mesh = nr.Mesh.icosphere(4)
    intrinsic = [[30.0, 0.0, 32.0], [0.0, 30.0, 32.0], [0.0, 0.0, 1.0]]
    camera = Camera.fisheye(intrinsic, torch.eye(3), (0.0, 0.0, 1.3), COEFFICIENTS, orig_size=64)
    depth = nr.render(mesh, camera, 64, outputs="depth", anti_aliasing=False).depth[0]
    rows, columns = torch.nonzero(depth < 100, as_tuple=True)
    assert len(rows) > 1000
    pixels = torch.stack((columns, rows), 1) + 0.5
    points = camera.unproject(pixels, depth[rows, columns])[0]
    # Edges of length 0.08 are chords: 0.08² / 8 below the sphere, and as much off where the lens would bend them.
    assert (points.norm(dim=1) - 1).abs().max() < 2e-3


def test_the_camera_may_be_inside_of_a_mesh() -> None:
    """Faces beside and behind it do not cover those before it."""
    vertices, faces = nr.cube()
    room = nr.Mesh(2 * vertices, faces.flip(1)).subdivide(4)
    intrinsic = [[30.0, 0.0, 32.0], [0.0, 30.0, 32.0], [0.0, 0.0, 1.0]]
    camera = Camera.fisheye(intrinsic, R, (0.1, -0.2, 0.3), orig_size=64)
    images = nr.render(room, camera, 64, outputs=("position", "depth"), anti_aliasing=False, near=0.05)
    rows, columns = torch.meshgrid(torch.arange(64) + 0.5, torch.arange(64) + 0.5, indexing="ij")
    centres = torch.stack((columns, rows), -1)
    shown = (centres - 32).norm(dim=-1) < 30 * np.radians(80)
    assert (images.depth[0][shown] < 100).all()
    pixels, _ = camera.project(images.position[0].movedim(0, 2)[shown])
    # Straight edges are up to 0.85 pixels off where faces of 10° reach beyond 80°, and a quarter of it after one more
    # subdivision. If points behind the camera were not mirrored, 5 pixels.
    assert (pixels[0] - centres[shown]).abs().max() < 1.5


def test_cameras_of_a_batch() -> None:
    both = Camera.cat([lens(), lens((0.1, 0.0, 0.0, 0.0))])
    assert both.is_fisheye and both.dist_coeffs.shape == (2, 4) and not Camera.look_at((0, 0, 1)).is_fisheye
    points = seen()[1]
    torch.testing.assert_close(both(points)[1:], lens((0.1, 0.0, 0.0, 0.0))(points))
    torch.testing.assert_close(both[1](points), both(points)[1:])
    pinhole = Camera.projection(K, R, SHIFT, orig_size=(480, 640))
    with pytest.raises(ValueError, match="expected one kind of lens, got K and fisheye"):
        Camera.cat([both, pinhole])
    with pytest.raises(ValueError, match=r"dist_coeffs: expected shape \[4\]"):
        lens((0.1,) * 5)
    matrix = np.concatenate((R, SHIFT[:, None]), 1)
    given = Camera.from_matrix(
        world_to_camera=matrix, K=K, dist_coeffs=COEFFICIENTS, orig_size=(480, 640), fisheye=True
    )
    torch.testing.assert_close(given.to(dtype=torch.float64)(points), lens()(points), rtol=1e-5, atol=1e-5)
