"""Dilation and erosion of masks by a disc."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def dilate(mask: Tensor, radius: int) -> Tensor:
    """Grow a mask [H, W] bool by a disc of this radius in pixels."""
    if radius <= 0:
        return mask
    tall = [mask]  # the mask, grown by 0, 1, … pixels upwards and downwards
    for _ in range(radius):
        taller = tall[-1].clone()
        taller[1:] |= tall[-1][:-1]
        taller[:-1] |= tall[-1][1:]
        tall.append(taller)
    grown, width = torch.zeros_like(mask), mask.shape[1]
    for across in range(-radius, radius + 1):  # the columns of the disc
        column = tall[math.isqrt(radius * radius - across * across)]
        left, right = max(across, 0), width + min(across, 0)
        if left < right:
            grown[:, left:right] |= column[:, left - across : right - across]
    return grown


def erode(mask: Tensor, radius: int) -> Tensor:
    """Shrink a mask [H, W] bool by a disc of this radius in pixels; outside of the image counts as object."""
    return ~dilate(~mask, radius)


def opened(mask: Tensor, radius: int) -> Tensor:
    """Remove parts of a mask [H, W] bool that are thinner than a disc: erosion, then dilation."""
    return dilate(erode(mask, radius), radius)
