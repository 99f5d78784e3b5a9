"""Connected components of masks."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from ..components import connected_components
from .resize import limit_size

_MOST_SEARCHED = 640  # largest side, in pixels, of masks in which specks are found
_MOST_FILLED = 1280  # largest side, in pixels, of masks in which holes are found
_SPECK = 0.02  # size, relative to the largest component, below which components are dropped


def remove_specks(alpha: Tensor) -> Tensor:
    """Set the small connected components of a mask [H, W] to 0."""
    small = limit_size(alpha[..., None], _MOST_SEARCHED)[..., 0]
    label = label_components(small > 0.5)
    count = torch.bincount(label[label >= 0])
    kept = torch.isin(label, (count >= _SPECK * count.max()).nonzero()[:, 0])
    wide = F.max_pool2d(kept[None, None].float(), 5, 1, 2)  # includes the soft outline
    return alpha * F.interpolate(wide, tuple(alpha.shape), mode="nearest")[0, 0]


def fill_holes(mask: Tensor, share: float) -> Tensor:
    """Fill the holes of a mask [H, W] bool that are smaller than this share of it, such as shadows and highlights.

    In a mask of more than 1280 pixels, holes are found at a lower resolution; narrower holes than its pixels stay.
    """
    block = math.ceil(max(mask.shape) / _MOST_FILLED)
    if block == 1:
        return mask | _small_holes(mask, share)
    coarse = F.max_pool2d(mask[None, None].float(), block, ceil_mode=True)[0, 0] > 0.5
    # Blocks around a hole may contain a part of the hole.
    holes = F.max_pool2d(_small_holes(coarse, share)[None, None].float(), 3, 1, 1)[0, 0] > 0.5
    return mask | holes.repeat_interleave(block, 0).repeat_interleave(block, 1)[: mask.shape[0], : mask.shape[1]]


def _small_holes(mask: Tensor, share: float) -> Tensor:
    """Find the holes of a mask [H, W] bool that are smaller than this share of it, [H, W] bool."""
    label = label_components(~mask)
    if not bool((label >= 0).any()):
        return torch.zeros_like(mask)
    small = torch.bincount(label[label >= 0]) < share * mask.sum()
    border = torch.cat((label[0], label[-1], label[:, 0], label[:, -1]))
    small[border[border >= 0]] = False
    return small[label.clamp(min=0)] & (label >= 0)


def label_components(mask: Tensor) -> Tensor:
    """Label the connected components of a mask [H, W] bool: int64 [H, W], -1 outside of the mask."""
    height, width = mask.shape
    index = torch.arange(height * width).reshape(height, width)
    across, down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    horizontal = torch.stack((index[:, 1:][across], index[:, :-1][across]), 1)
    vertical = torch.stack((index[1:][down], index[:-1][down]), 1)
    label = connected_components(torch.cat((horizontal, vertical)), height * width)
    return torch.where(mask, label.reshape(height, width), -1)
