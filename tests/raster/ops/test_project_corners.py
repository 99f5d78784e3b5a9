"""Corners on the screen by one operator, held to the camera and gathering one after the other, and to float64."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.camera.screen import screen_corners
from neural_renderer.raster.faces import corners_of
from neural_renderer.raster.ops.project_corners import project_corners

BATCHES = [(1, None), (3, None), (3, 3), (1, 3)]


def scene(device, cameras, meshes, orthographic=False, dtype=torch.float32, camera_too=True):
    """Random triangles around cameras, and one of padding; points, and perhaps cameras, are leaves with gradients."""
    random = torch.Generator().manual_seed(cameras)
    points = torch.randn((12, 3) if meshes is None else (meshes, 12, 3), generator=random)
    faces = torch.randint(0, 12, (20, 3) if meshes is None else (meshes, 20, 3), generator=random)
    faces[..., -1, :] = -1
    eye = torch.tensor([0.0, 0.0, -6.0]) + 0.3 * torch.randn(cameras, 3, generator=random)
    width = 30 * (0.5 + torch.rand(cameras, generator=random))
    leaves = [part.to(device, dtype).requires_grad_(camera_too) for part in (points, eye, width)]
    leaves[0].requires_grad_()
    lens = {"orthographic": True, "scale": leaves[2]} if orthographic else {"viewing_angle": leaves[2]}
    return leaves, faces.to(device), nr.Camera.look_at(leaves[1], **lens)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("cameras, meshes", BATCHES)
def test_values_are_those_of_the_camera(device, cameras, meshes, orthographic):
    (points, _, _), faces, camera = scene(device, cameras, meshes, orthographic)
    expected = corners_of(camera(points, aspect=1.5), faces)
    assert torch.equal(screen_corners(camera, points, faces, 1.5)[0], expected)


@pytest.mark.parametrize("camera_too", [False, True])
@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("cameras, meshes", BATCHES)
def test_gradients(device, cameras, meshes, orthographic, camera_too):
    leaves, faces, camera = scene(device, cameras, meshes, orthographic, torch.float32, camera_too)
    exact_leaves, _, exact_camera = scene(device, cameras, meshes, orthographic, torch.float64, camera_too)
    count = 3 if camera_too else 1
    screen = exact_camera(exact_leaves[0], aspect=1.5)
    index = (faces if faces.dim() == 3 else faces[None]).clamp(min=0).expand(len(screen), -1, -1)
    exact = screen.gather(1, index.flatten(1)[..., None].expand(-1, -1, 3)).unflatten(1, (-1, 3))
    random = torch.Generator().manual_seed(0)
    grad = torch.randn(exact.shape, generator=random, dtype=torch.float64).to(device)
    ours = torch.autograd.grad(screen_corners(camera, leaves[0], faces, 1.5)[0], leaves[:count], grad.float())
    theirs = torch.autograd.grad(exact, exact_leaves[:count], grad)
    for one, other in zip(ours, theirs, strict=True):
        # Each gradient is a sum of some hundreds of terms at most, each of some 30 roundings.
        torch.testing.assert_close(one.double(), other, rtol=0, atol=1e-4 * other.detach().abs().max().item())


@pytest.mark.parametrize("cameras, meshes", BATCHES)
def test_cameras_with_intrinsics(device, cameras, meshes):
    """Values and gradients, also to K and the translation, are those of the camera in float64."""

    def corners(dtype, project):
        (points, _, _), faces, _ = scene(device, cameras, meshes, dtype=dtype)
        random = torch.Generator().manual_seed(2)
        turns, _ = torch.linalg.qr(torch.randn(cameras, 3, 3, generator=random))
        turns = (turns * torch.linalg.det(turns).sign()[:, None, None]).to(device)
        K = torch.tensor([[90.0, 3.0, 40.0], [0.0, 110.0, 70.0], [0.0, 0.0, 1.0]]).repeat(cameras, 1, 1)
        move = torch.tensor([0.2, -0.1, 9.0]) + 0.3 * torch.randn(cameras, 3, generator=random)
        leaves = [points, *(part.to(device, dtype).requires_grad_() for part in (K, move))]
        camera = nr.Camera.projection(leaves[1], turns.to(dtype), leaves[2], None, (100, 140))
        found = project(camera, points, faces)
        random = torch.Generator().manual_seed(0)
        grad = torch.randn(found.shape, generator=random, dtype=torch.float64).to(device, dtype)
        return found, *torch.autograd.grad(found, leaves, grad)

    def exact(camera, points, faces):
        screen = camera(points)
        index = (faces if faces.dim() == 3 else faces[None]).clamp(min=0).expand(len(screen), -1, -1)
        return screen.gather(1, index.flatten(1)[..., None].expand(-1, -1, 3)).unflatten(1, (-1, 3))

    ours = corners(torch.float32, lambda camera, points, faces: screen_corners(camera, points, faces, 1.5)[0])
    theirs = corners(torch.float64, exact)
    for one, other, rounding in zip(ours, theirs, (1e-6, 1e-4, 1e-4, 1e-4), strict=True):
        torch.testing.assert_close(one.double(), other, rtol=0, atol=rounding * other.detach().abs().max().item())


def test_an_index_out_of_range_gives_nan_without_checks(device):
    (points, _, _), faces, camera = scene(device, 1, None)
    faces[0, 0], faces[1, 1] = 12, -2
    nr.check_values(False)
    try:
        corners, _ = screen_corners(camera, points, faces, 1.0)
    finally:
        nr.check_values(True)
    wrong = torch.zeros(1, 20, 3, dtype=torch.bool, device=device)
    wrong[0, 0, 0] = wrong[0, 1, 1] = True
    assert torch.equal(corners.isnan().any(-1), wrong)
    [gradient] = torch.autograd.grad(corners[~wrong].sum(), [points])
    assert gradient.isfinite().all()


def test_operator_is_well_formed(device):
    (points, _, _), faces, camera = scene(device, 3, 3)
    width = torch.tensor([0.5], device=device)
    inputs = points, faces.int(), camera.rotation, camera.origin, width, 1.5, True
    torch.library.opcheck(project_corners.operator, inputs)
