"""Dilation and erosion of masks by a disc."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def dilate(mask: Tensor, radius: int) -> Tensor:
    """Grow a mask [H, W] bool by a disc of this radius in pixels."""
    if radius <= 0:
        return mask
    # A column of the disc at a time: the running maximum of a column is one pass over the image.
    grown = torch.zeros_like(mask)
    width = mask.shape[1]
    for across in range(-radius, radius + 1):
        half = int((radius * radius - across * across) ** 0.5)
        tall = F.max_pool2d(mask[None, None].float(), (2 * half + 1, 1), 1, (half, 0))[0, 0] > 0.5
        left, right = max(across, 0), width + min(across, 0)
        if left < right:
            grown[:, left:right] |= tall[:, left - across : right - across]
    return grown


def erode(mask: Tensor, radius: int) -> Tensor:
    """Shrink a mask [H, W] bool by a disc of this radius in pixels; outside of the image counts as object."""
    return ~dilate(~mask, radius)


def opened(mask: Tensor, radius: int) -> Tensor:
    """Remove parts of a mask [H, W] bool that are thinner than a disc: erosion, then dilation."""
    return dilate(erode(mask, radius), radius)
