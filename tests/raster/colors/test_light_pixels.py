"""Lit colours over a background, held to float64 torch, in value and in gradient."""

from __future__ import annotations

import pytest
import torch

from neural_renderer.raster.colors.light_pixels import light_pixels
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.reference.operators import sides


def scene(device, images, lamps):
    random = torch.Generator().manual_seed(images)
    faces = torch.rand(images, 12, 3, 3, generator=random) * 2 - 1
    faces[..., 2] += 3
    faces[0, 0, 0, 2] = -1.0  # a corner behind the camera
    colors, behind = torch.rand(images, 9, 11, 3, generator=random), torch.rand(1, 3, 1, 1, generator=random)
    light = torch.rand(lamps, 2, 12, 3, generator=random)
    faces = faces.to(device)
    parts = (part.to(device).requires_grad_() for part in (colors, behind, light))
    return *parts, faces, coverage(faces, 9, 11, 0.1, 100.0, True, True), True


@pytest.mark.parametrize("images, lamps", [(1, 1), (3, 1), (3, 3)])
def test_reference(device, images, lamps):
    colors, behind, light, faces, face_index, perspective = scene(device, images, lamps)
    exact, far, lamp = (part.detach().double().requires_grad_() for part in (colors, behind, light))
    assert (face_index < 0).any() and (face_index >= 0).any()

    back = (sides(faces, perspective) < 0).long()
    own = lamp.expand(images, -1, -1, -1).gather(1, back[:, None, :, None].expand(-1, -1, -1, 3))[:, 0]
    index = face_index.clamp(min=0).long().flatten(1)[..., None].expand(-1, -1, 3)
    lit = exact * own.gather(1, index).view_as(exact)
    expected = torch.where((face_index < 0)[:, None], far, lit.movedim(3, 1))
    result = light_pixels(colors, behind, light, faces, face_index, perspective)
    torch.testing.assert_close(result.double(), expected, rtol=2.0**-23, atol=0)

    grad = torch.rand(result.shape, generator=torch.Generator().manual_seed(0)).to(device)
    ours = torch.autograd.grad(result, (colors, light, behind), grad)
    theirs = torch.autograd.grad(expected, (exact, lamp, far), grad.double())
    # A sum of positive numbers, one for each pixel of all images, is off by that many roundings at most.
    torch.testing.assert_close(ours[0].double(), theirs[0], rtol=2.0**-23, atol=0)
    for mine, true in zip(ours[1:], theirs[1:], strict=True):
        torch.testing.assert_close(mine.double(), true, rtol=300 * 2.0**-24, atol=0)


def test_operator_is_well_formed(device):
    torch.library.opcheck(light_pixels.operator, scene(device, 2, 1))
