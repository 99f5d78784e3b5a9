"""Resizing of pictures and masks."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


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
