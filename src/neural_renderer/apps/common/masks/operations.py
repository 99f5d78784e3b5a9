"""Operations on masks: resizing, dilation and erosion by a disc, specks and holes."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

SAME_SHAPE = 0.02
"""Relative difference of two ratios of height to width that are equal but for rounding."""
SMALL_HOLE = 0.02
"""Share of an object, below which a hole in it is a mistake, such as a highlight."""
_OUTLINE = 640  # pixels of a mask's longer side for each two pixels of a soft outline
_NEAR, _LEAST_CONTRAST = 2, 0.1  # radius in pixels of the two colours at an outline; lower contrast is ignored
_SPECK = 0.02  # size, relative to the largest component, below which components are dropped


def limit_size(image: Tensor, most: int) -> Tensor:
    """Shrink an image [H, W, C] to at most ``most`` pixels a side; colours are weighted by alpha, if there is any."""
    height, width = image.shape[:2]
    scale = most / max(height, width)
    if scale >= 1:
        return image
    weighted = image if image.shape[2] != 4 else torch.cat((image[..., :3] * image[..., 3:], image[..., 3:]), 2)
    size = (max(1, round(scale * height)), max(1, round(scale * width)))
    small = resize(weighted.permute(2, 0, 1), size).permute(1, 2, 0)
    if image.shape[2] != 4:
        return small
    return torch.cat((small[..., :3] / small[..., 3:].clamp(min=1e-6), small[..., 3:]), 2)


def resize(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize an image [C, H, W]."""
    if tuple(image.shape[1:]) == size:
        return image
    return F.interpolate(image[None], size, mode="bilinear", antialias=True, align_corners=False)[0].clamp(0, 1)


def upright(image: Tensor, turn: int) -> Tensor:
    """Rotate an image [..., H, W] by EXIF's orientation 5, 6, 7 or 8; other values leave it unchanged.

    6 and 8 are inverse to each other, 5 and 7 to themselves.
    """
    turned = {5: lambda: image.mT, 6: lambda: image.rot90(-1, (-2, -1)), 7: lambda: image.mT.rot90(2, (-2, -1))}
    return turned.get(turn, lambda: image.rot90(1, (-2, -1)) if turn == 8 else image)()


def centered(image: Tensor, size: tuple[int, int], value: float = 0.0) -> Tensor:
    """Put an image [C, H, W] in the middle of a larger one of one value."""
    down, across = size[0] - image.shape[1], size[1] - image.shape[2]
    return F.pad(image, (across // 2, across - across // 2, down // 2, down - down // 2), value=value)


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
    """Set a mask [H, W] to 0 outside of its large connected components and their soft outlines."""
    label = label_components(alpha > 0.5)
    count = torch.bincount(label.flatten())
    count[0] = 0
    large = count >= _SPECK * count.max()
    large[0] = False
    if int(torch.count_nonzero(alpha)) == int(count[large].sum()):
        return alpha  # no small components
    from scipy import ndimage  # imported here because it is slow

    outline = 1 + 4 * math.ceil(max(alpha.shape) / _OUTLINE)
    kept = ndimage.maximum_filter(large[label].numpy(), outline)
    return torch.where(torch.from_numpy(kept), alpha, 0.0)


def fill_holes(mask: Tensor, share: float) -> Tensor:
    """Fill the holes of a mask [H, W] bool that are smaller than this share of it, such as shadows and highlights."""
    label = label_components(~mask)
    small = torch.bincount(label.flatten()) < share * mask.sum()
    return mask | (small[label] & ~at_border(label))


def mixed_at_outline(mask: Tensor, rgb: Tensor) -> Tensor:
    """Replace a mask [H, W] at its outline by alpha, estimated from the colours of the picture [H, W, 3].

    A threshold counts mixed pixels fully as object, so that its outline lies half a pixel too far outside.
    """
    inside, colors = mask > 0.5, rgb.permute(2, 0, 1)
    parts, means = (erode(inside, 1), erode(~inside, 1)), []
    known = ~(parts[0] | parts[1])
    for part in parts:
        layers = torch.cat((colors * part, part[None].float()))
        mean = F.avg_pool2d(layers[None], 2 * _NEAR + 1, 1, _NEAR)[0]
        means.append(mean[:3] / mean[3:].clamp(min=1e-6))
        known &= mean[3] > 0
    contrast = means[0] - means[1]
    share = ((colors - means[1]) * contrast).sum(0) / contrast.square().sum(0).clamp(min=1e-6)
    return torch.where(known & (contrast.abs().amax(0) > _LEAST_CONTRAST), share.clamp(0, 1), mask)


def label_components(mask: Tensor) -> Tensor:
    """Number the connected components of a mask [H, W] bool, from 1 on: int32 [H, W], 0 outside of the mask."""
    from scipy import ndimage

    return torch.from_numpy(ndimage.label(mask.numpy())[0])


def at_border(label: Tensor) -> Tensor:
    """Find the components, as from `label_components`, that touch the border of the picture: bool [H, W]."""
    touching = torch.zeros(int(label.max()) + 1, dtype=torch.bool)
    touching[torch.cat((label[0], label[-1], label[:, 0], label[:, -1]))] = True
    touching[0] = False
    return touching[label]
