"""Colours before a background, against `torch.where`."""

from __future__ import annotations

import pytest
import torch

from neural_renderer.raster.colors.composite import composite


def scene(device, channels, shape):
    random = torch.Generator().manual_seed(channels)
    index = torch.randint(-2, 3, (2, 5, 11), generator=random, dtype=torch.int32).clamp(min=-1)
    colors = torch.randn(2, 5, 11, channels, generator=random)
    behind = torch.randn([channels if side == "C" else side for side in shape], generator=random)
    return colors.to(device).requires_grad_(), behind.to(device).requires_grad_(), index.to(device)


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 9])
@pytest.mark.parametrize("shape", [(1, "C", 1, 1), (2, "C", 1, 1), (1, "C", 5, 11), (2, "C", 5, 11), (1, 1, 5, 1)])
def test_values_and_gradients(device, channels, shape):
    colors, behind, index = scene(device, channels, shape)
    whole = behind.expand(-1, channels, -1, -1)
    image = composite(colors, whole, index)
    expected = torch.where((index >= 0)[:, None], colors.permute(0, 3, 1, 2), whole)
    assert torch.equal(image, expected)
    # Whole numbers, because their sums are exact in any order; the tensor is not contiguous.
    grad = torch.arange(expected.numel(), device=device).float().view(5, 11, 2, channels).permute(2, 3, 0, 1)
    ours = torch.autograd.grad(image, (colors, behind), grad)
    theirs = torch.autograd.grad(expected, (colors, behind), grad)
    assert torch.equal(ours[0], theirs[0]) and torch.equal(ours[1], theirs[1])


def test_a_background_that_is_turned_over(device):
    colors, behind, index = scene(device, 3, (2, "C", 11, 5))
    turned = behind.transpose(2, 3)
    expected = torch.where((index >= 0)[:, None], colors.permute(0, 3, 1, 2), turned)
    assert torch.equal(composite(colors, turned, index), expected)


def test_operator_is_well_formed(device):
    torch.library.opcheck(composite.operator, scene(device, 3, (1, "C", 1, 1)))
