"""Light on faces by one operator, held to `Light.two_sided` in float64 torch, in value and in gradient."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.ops.flat_light import flat_light
from neural_renderer.shading.lights import light_factors


def scene(device, meshes, lights, dtype=torch.float32):
    """Faces, of which one is huge, one small, one an edge and one a point, and lights; all leaves have gradients."""
    random = torch.Generator().manual_seed(meshes)
    corners = torch.randn(meshes, 30, 3, 3, generator=random)
    corners[0, 0] *= 1e6
    corners[0, 1] *= 1e-3
    corners[0, 2, 2] = corners[0, 2, 1]
    corners[0, 3] = 0.5
    colors = torch.rand(2, lights, 3, generator=random)
    direction = torch.randn(lights, 3, generator=random)
    leaves = [part.to(device, dtype).requires_grad_() for part in (corners, *colors, direction)]
    light = nr.Light(ambient=0.25, directional=2.0, ambient_color=leaves[1], directional_color=leaves[2])
    return leaves, nr.Light(**{**vars(light), "direction": leaves[3]})


def soup(corners):
    """Vertices and faces of triangles that share no vertex."""
    return corners.flatten(1, 2), torch.arange(corners.shape[1] * 3, device=corners.device).view(-1, 3)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("meshes, lights", [(1, 1), (3, 1), (1, 3), (3, 3)])
def test_reference(device, meshes, lights, mirrored):
    leaves, light = scene(device, meshes, lights)
    exact_leaves, exact_light = scene(device, meshes, lights, torch.float64)
    batch = max(meshes, lights)
    ours = light_factors([light], *soup(leaves[0]), batch, mirrored)
    exact = exact_light.two_sided(exact_leaves[0].expand(batch, -1, -1, -1), mirrored)
    # A normal is off by some 20 roundings of 1; the light is up to 2 sqrt(3) times its part along the direction.
    size = 2 * float(exact_leaves[3].detach().norm(dim=1).max())
    torch.testing.assert_close(ours.double(), exact, rtol=0, atol=20 * 2.0**-24 * size)

    grad = torch.randn(exact.shape, dtype=torch.float64, device=device)
    mine = torch.autograd.grad(ours, leaves, grad.float())
    theirs = torch.autograd.grad(exact, exact_leaves, grad)
    # The gradient of a face is as large as it is small: each is compared by its own size, the edge's and the point's by
    # the largest that their floor of an area allows.
    size = theirs[0].abs().amax((2, 3), keepdim=True).clamp(min=1e-3)
    torch.testing.assert_close(mine[0].double() / size, theirs[0] / size, rtol=0, atol=1e-4)
    for one, other in zip(mine[1:], theirs[1:], strict=True):
        torch.testing.assert_close(one.double(), other, rtol=0, atol=1e-4 * float(other.abs().max()))


def test_numbers_are_converted_once_and_tensors_each_time(device):
    corners = scene(device, 1, 1)[0][0].detach()
    direction = torch.tensor([0.0, 1.0, 0.0])
    constant, changing = nr.Light(), nr.Light(direction=direction)
    before = light_factors([constant], *soup(corners), 1, False), light_factors([changing], *soup(corners), 1, False)
    direction.neg_()
    after = light_factors([constant], *soup(corners), 1, False), light_factors([changing], *soup(corners), 1, False)
    assert torch.equal(before[0], after[0]) and torch.equal(before[1], after[1].flip(1))
    with pytest.raises(ValueError, match="direction: expected"):
        light_factors([nr.Light(direction=torch.full((3,), torch.nan))], *soup(corners), 1, False)


def test_operator_is_well_formed(device):
    leaves, _ = scene(device, 2, 1)
    vertices, faces = soup(leaves[0])
    torch.library.opcheck(flat_light.operator, (vertices, faces[None].int(), *leaves[1:], False))
