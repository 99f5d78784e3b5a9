"""Weights and depth, and their gradient, against the reference and against finite differences."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given

from neural_renderer.raster.ops.barycentrics import barycentrics
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.reference.operators import barycentrics_reference
from tests.raster.scenes import FAR, NEAR, condition, crosses, examples, scenes
from tests.rounding import EPS, relative

FRONT = ("plain", "tiny", "outside", "point", "line", "copy", "flat")


def drawn(scene, device):
    faces = scene.faces.to(device)
    shape = (scene.height, scene.width)
    return faces, coverage(faces, *shape, NEAR, FAR, scene.two_sided, scene.perspective)


def at_pixels(per_face, face_index):
    """A number per face [B, F] at the pixels that show it, 0 elsewhere."""
    image = torch.arange(len(per_face))[:, None, None]
    if not per_face.shape[1]:
        return torch.zeros(face_index.shape, dtype=per_face.dtype)
    return torch.where(face_index >= 0, per_face[image, face_index.clamp(min=0).long()], 0)


@examples(60)
@given(scene=scenes())
def test_values(device, scene):
    faces, face_index = drawn(scene, device)
    weights, depth = (t.cpu() for t in barycentrics(faces, face_index, NEAR, FAR, scene.perspective))
    faces, face_index = faces.cpu(), face_index.cpu()
    expected_weights, expected_depth = barycentrics_reference(faces, face_index, NEAR, FAR, scene.perspective)
    empty = face_index < 0
    assert (depth[empty] == FAR).all() and (weights[empty] == 0).all()
    front = ~empty & ~at_pixels(crosses(faces, scene.perspective).int(), face_index).bool()
    assert ((weights >= 0) & (weights <= 1)).all() and ((depth >= NEAR) & (depth <= FAR)).all()
    assert ((weights.sum(-1) - 1).abs() <= 1e-6)[front].all()
    # The few roundings of 2^-24 grow by the face's condition: one much smaller than a pixel knows little.
    error = 1e-6 + 2e-6 * at_pixels(condition(faces, scene.height, scene.width).nan_to_num(1e9, 1e9), face_index)
    assert ((weights - expected_weights).abs() <= error[..., None])[front].all()
    z = at_pixels(faces[..., 2].amax(-1), face_index), at_pixels(faces[..., 2].amin(-1), face_index)
    spread = (z[0] - z[1]) * error.clamp(max=1) * 9  # dz / dw is at most (z_max / z_min) times the spread of z
    assert ((depth - expected_depth).abs() <= spread + 1e-6 * expected_depth)[front].all()
    # A face through the camera's plane: float64 inside, but x and y of the centre are float32.
    rest = ~front & ~empty
    size = expected_weights.abs().amax(-1).clamp(min=1)
    assert ((weights - expected_weights).abs().amax(-1) <= 1e-4 * size)[rest].all()
    assert ((depth - expected_depth).abs() <= 1e-4 * expected_depth * (1 + expected_depth))[rest].all()


@examples(40)
@given(scene=scenes(FRONT, empty=False))
def test_gradient(device, scene):
    faces, face_index = drawn(scene, device)
    weights, depth = barycentrics(faces.requires_grad_(), face_index, NEAR, FAR, scene.perspective)
    # Only well-conditioned faces; others amplify the rounding errors of the weights.
    cond = condition(faces.detach().cpu(), scene.height, scene.width).nan_to_num(1e9, 1e9)
    good = (at_pixels(cond, face_index.cpu()) < 3000).to(device)
    to_weights = scene.noise(*weights.shape).to(device) * good[..., None]
    to_depth = scene.noise(*depth.shape).flip(0).to(device) * good
    (found,) = torch.autograd.grad((weights, depth), faces, (to_weights, to_depth))
    exact = faces.detach().cpu().double().requires_grad_()
    images = barycentrics_reference(exact, face_index.cpu(), NEAR, FAR, scene.perspective)
    (expected,) = torch.autograd.grad(images, exact, (to_weights.double().cpu(), to_depth.double().cpu()))
    assert not found.cpu()[expected == 0].any()
    # Each pixel's part is off by the condition in 2^-24; the parts partly cancel.
    size = expected.abs().flatten(2).amax(2)
    pixels = torch.stack([torch.bincount(i[i >= 0].flatten(), minlength=scene.count) for i in face_index.cpu()])
    error = 2e-6 * cond * (1 + pixels.sqrt())
    assert ((found.cpu() - expected).abs().flatten(2).amax(2) <= error * size + 1e-6).all()


@examples(20)
@given(scene=scenes(("crossing",), most_faces=3, empty=False))
def test_gradient_through_the_camera_plane(device, scene):
    faces, face_index = drawn(scene, device)
    _, depth = barycentrics(faces.requires_grad_(), face_index, NEAR, FAR, scene.perspective)
    to_depth = scene.noise(*depth.shape).to(device)
    (found,) = torch.autograd.grad(depth, faces, to_depth)
    exact = faces.detach().cpu().double().requires_grad_()
    images = barycentrics_reference(exact, face_index.cpu(), NEAR, FAR, scene.perspective)
    (expected,) = torch.autograd.grad(images[1], exact, to_depth.double().cpu())
    cond = condition(faces.detach().cpu(), scene.height, scene.width)
    error = (1e-3 + 1e-5 * cond)[..., None, None] * expected.abs().amax((2, 3), keepdim=True)
    assert ((found.cpu() - expected).abs() <= error + 1e-6).all()


def test_depth_gradient_is_the_finite_difference(device):
    faces = torch.tensor([[[[-0.8, -0.7, 1.0], [0.9, -0.5, 2.0], [0.1, 0.8, 3.0]]]], device=device)
    for perspective in (True, False):
        index = coverage(faces, 16, 24, NEAR, FAR, False, perspective)
        moved = faces.clone().requires_grad_()
        barycentrics(moved, index, NEAR, FAR, perspective)[1].sum().backward()
        step = torch.randn(faces.shape, generator=torch.Generator().manual_seed(0)).to(device) * 1e-3
        high, low = (barycentrics(faces + s * step, index, NEAR, FAR, perspective)[1].double() for s in (1, -1))
        inside = (index >= 0) & (barycentrics(faces, index, NEAR, FAR, perspective)[0].amin(-1) > 0.01)
        moved.grad = None
        barycentrics(moved, index, NEAR, FAR, perspective)[1].backward(inside.float())
        # Depths up to 3, each a few roundings off, at up to 16 x 24 pixels; the third derivative adds less.
        difference = ((high - low)[inside].sum() / 2).float()
        torch.testing.assert_close(difference, (moved.grad * step).sum(), rtol=1e-3, atol=16 * 24 * 3 * EPS)


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (1, 0), (0, 1)])
def test_faces_however_small_or_thin(device, perspective, shape):
    """Around a pixel's centre, where they are drawn, though their areas in pixels round to 0."""
    exponents = torch.arange(6, 20, dtype=torch.float64)
    sizes = torch.stack([(10**-exponents) ** power for power in (*shape, 0)], -1)[:, None, None]
    corners = torch.tensor([[-0.75, -0.5, 2.0], [0.5, -0.75, 3.0], [0.25, 0.5, 4.0]], dtype=torch.float64)
    faces = (corners * sizes).float().to(device).requires_grad_()
    index = coverage(faces.detach(), 5, 5, NEAR, FAR, False, perspective)
    assert (index[:, 2, 2] == 0).all()
    weights, depth = barycentrics(faces, index, NEAR, FAR, perspective)
    exact = faces.detach().cpu().double().requires_grad_()
    expected = barycentrics_reference(exact, index.cpu(), NEAR, FAR, perspective)
    # At the middle of the image arms are the corners themselves: products, sums and quotients, each of 2^-24.
    torch.testing.assert_close(weights[:, 2, 2].cpu().double(), expected[0][:, 2, 2], **relative(32))
    torch.testing.assert_close(depth[:, 2, 2].cpu().double(), expected[1][:, 2, 2], **relative(32))
    pull = torch.tensor([1.0, -2.0, 3.0])
    (found,) = torch.autograd.grad((weights[:, 2, 2] * pull.to(device)).sum() + depth[:, 2, 2].sum(), faces)
    (wanted,) = torch.autograd.grad((expected[0][:, 2, 2] * pull).sum() + expected[1][:, 2, 2].sum(), exact)
    size = wanted.abs().amax(2, keepdim=True)
    assert ((found.cpu() - wanted).abs() <= 1e-5 * size).all()
    # Narrower than four roundings of a coordinate near 1, a face is moved along the viewing axis only.
    assert found[0, ..., :2].any() and not found[1:, ..., :2].any() and found[..., 2].any((1, 2)).all()


def test_a_face_without_area_counts_for_its_middle(device):
    """Values at pixels without a drawn face are finite, too."""
    faces = torch.tensor([[[0.3, 0.3, 1.0], [0.3, 0.3, 2.0], [0.3, 0.3, 3.0]]], device=device)[None].requires_grad_()
    index = torch.zeros(1, 4, 4, dtype=torch.int32, device=device)
    weights, depth = barycentrics(faces, index, NEAR, FAR, False)
    torch.testing.assert_close(weights, torch.full_like(weights, 1 / 3))
    torch.testing.assert_close(depth, torch.full_like(depth, 2))
    (weights.sum() + depth.sum()).backward()
    assert faces.grad.isfinite().all()
