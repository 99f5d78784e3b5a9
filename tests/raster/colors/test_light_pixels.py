"""Light on an image, held to float64 torch, in value and in gradient."""

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
    image = torch.rand(images, 3, 9, 11, generator=random)
    light = torch.rand(lamps, 2, 12, 3, generator=random)
    faces, image, light = faces.to(device), image.to(device).requires_grad_(), light.to(device).requires_grad_()
    return image, light, faces, coverage(faces, 9, 11, 0.1, 100.0, True, True), True


@pytest.mark.parametrize("images, lamps", [(1, 1), (3, 1), (3, 3)])
def test_reference(device, images, lamps):
    image, light, faces, face_index, perspective = scene(device, images, lamps)
    exact, lamp = (part.detach().double().requires_grad_() for part in (image, light))
    assert (face_index < 0).any() and (face_index >= 0).any()

    back = (sides(faces, perspective) < 0).long()
    own = lamp.expand(images, -1, -1, -1).gather(1, back[:, None, :, None].expand(-1, -1, -1, 3))[:, 0]
    index = face_index.clamp(min=0).long().flatten(1)[..., None].expand(-1, -1, 3)
    factors = own.gather(1, index).transpose(1, 2).view_as(exact)
    expected = exact * torch.where((face_index < 0)[:, None], 1.0, factors)
    result = light_pixels(image, light, faces, face_index, perspective)
    torch.testing.assert_close(result.double(), expected, rtol=2.0**-23, atol=0)

    grad = torch.rand(image.shape, generator=torch.Generator().manual_seed(0)).to(device)
    ours = torch.autograd.grad(result, (image, light), grad)
    theirs = torch.autograd.grad(expected, (exact, lamp), grad.double())
    # A sum of positive numbers, one for each pixel of all images, is off by that many roundings at most.
    torch.testing.assert_close(ours[0].double(), theirs[0], rtol=2.0**-23, atol=0)
    torch.testing.assert_close(ours[1].double(), theirs[1], rtol=300 * 2.0**-24, atol=0)


def test_operator_is_well_formed(device):
    torch.library.opcheck(light_pixels.operator, scene(device, 2, 1))
