"""Projection by one operator, held to torch: to the bit in float32, and to float64 in its gradient."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.camera.screen import screen_corners
from tests.cuda_emulation.tensors import Gpu, GpuTensor

BATCHES = [(1, None), (3, None), (3, 3), (1, 3), (3, 1), (1, 0)]


def scene(device, cameras, meshes, orthographic, dtype=torch.float32, vertices=40):
    """Points around cameras, some of them on and behind the cameras' planes; the leaves have gradients."""
    random = torch.Generator().manual_seed(cameras)
    shape = (vertices, 3) if meshes is None else (meshes, vertices, 3)
    points = torch.randn(shape, generator=random)
    eye = torch.tensor([0.0, 0.0, -1.5]) + 0.3 * torch.randn(cameras, 3, generator=random)
    width = 0.5 + torch.rand(cameras, generator=random)
    if points.numel():
        points.view(-1, 3)[0] = eye[0]
    leaves = [part.to(device, dtype).requires_grad_() for part in (points, eye, 30 * width)]
    lens = {"orthographic": True, "scale": leaves[2]} if orthographic else {"viewing_angle": leaves[2]}
    return leaves, nr.Camera.look_at(leaves[1], **lens)


def screen_positions(camera, points, aspect):
    """Project points as corners of faces, one for each."""
    faces = torch.arange(points.shape[-2], device=points.device)[:, None].expand(-1, 3)
    return screen_corners(camera, points, faces, aspect)[0][:, :, 0]


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("cameras, meshes", BATCHES)
def test_values_are_those_of_the_camera(device, cameras, meshes, orthographic):
    (points, _, _), camera = scene(device, cameras, meshes, orthographic)
    expected = camera(points, aspect=1.5)
    assert torch.equal(screen_positions(camera, points, 1.5), expected)


@pytest.mark.parametrize("orthographic", [False, True])
def test_torch_on_cuda_divides_no_position_by_a_number(orthographic):
    """There it multiplies by the reciprocal, which rounds twice; the kernels round once."""
    (points, eye, _), _ = scene("cpu", 3, None, orthographic)
    lens = {"orthographic": True, "scale": 0.7} if orthographic else {"viewing_angle": 25.0}
    expected = nr.Camera.look_at(eye.detach(), **lens)(points.detach(), aspect=1.5)
    with Gpu():
        found = nr.Camera.look_at(GpuTensor(eye.detach()), **lens)(GpuTensor(points.detach()), aspect=1.5)
    assert torch.equal(found.inner, expected)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("cameras, meshes", BATCHES[:-1])
def test_gradients(device, cameras, meshes, orthographic):
    leaves, camera = scene(device, cameras, meshes, orthographic)
    exact_leaves, exact_camera = scene(device, cameras, meshes, orthographic, torch.float64)
    exact = exact_camera(exact_leaves[0], aspect=1.5)
    # Points at the camera's plane are projected far away; what is sent to them is the smaller.
    grad = torch.randn(exact.shape, dtype=torch.float64, device=device) / (1 + exact.detach().abs()) ** 2
    ours = torch.autograd.grad(screen_positions(camera, leaves[0], 1.5), leaves, grad.float())
    theirs = torch.autograd.grad(exact, exact_leaves, grad)
    for one, other in zip(ours, theirs, strict=True):
        # Each gradient is a sum of some hundreds of terms at most, each of some 30 roundings.
        torch.testing.assert_close(one.double(), other, rtol=0, atol=1e-4 * float(other.abs().max()))


def test_a_camera_of_another_class_projects_as_it_likes(device):
    class Turned(nr.Camera):
        def __call__(self, vertices, aspect=1.0):
            return super().__call__(-vertices, aspect)

    (points, _, _), camera = scene(device, 1, None, False)
    turned = Turned(camera.rotation, camera.origin, camera.translation, camera.viewing_angle)
    assert torch.equal(screen_positions(turned, points, 1.0), camera(-points))


def test_errors_are_those_of_the_camera():
    camera = nr.Camera.look_at(torch.eye(3) - 0.5, viewing_angle=torch.tensor([30.0, 40.0, 50.0]))
    for points in (torch.zeros(2, 4, 3), torch.full((4, 3), torch.nan), torch.zeros(4, 2)):
        with pytest.raises(ValueError) as expected:
            camera(points)
        with pytest.raises(ValueError) as got:
            screen_positions(camera, points, 1.0)
        assert str(got.value) == str(expected.value)
