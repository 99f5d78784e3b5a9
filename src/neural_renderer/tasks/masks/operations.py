"""Operations on masks: resizing, dilation and erosion by a disc, specks and holes."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from ..components import connected_components

_MOST_SEARCHED = 640  # largest side, in pixels, of masks in which specks are found
_MOST_FILLED = 1280  # largest side, in pixels, of masks in which holes are found
_SPECK = 0.02  # size, relative to the largest component, below which components are dropped


def limit_size(image: Tensor, most: int) -> Tensor:
    """Shrink an image [H, W, C] to at most ``most`` pixels a side; colours are weighted by alpha, if there is any."""
    height, width = image.shape[:2]
    scale = most / max(height, width)
    if scale >= 1:
        return image
    weighted = image if image.shape[2] < 4 else torch.cat((image[..., :3] * image[..., 3:], image[..., 3:]), 2)
    size = (max(1, round(scale * height)), max(1, round(scale * width)))
    small = resize(weighted.permute(2, 0, 1), size).permute(1, 2, 0)
    if image.shape[2] < 4:
        return small
    return torch.cat((small[..., :3] / small[..., 3:].clamp(min=1e-6), small[..., 3:]), 2)


def resize(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize an image [C, H, W]."""
    if tuple(image.shape[1:]) == size:
        return image
    return F.interpolate(image[None], size, mode="bilinear", antialias=True, align_corners=False)[0].clamp(0, 1)


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
