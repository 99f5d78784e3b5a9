"""Cutting an object out of a picture, and framing it like the training data."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....io.files import warn
from ...common.masks.operations import SAME_SHAPE, at_border, label_components, limit_size, remove_specks, resize
from ...common.masks.rule import BusyBackground, box_mask, plain_background_mask, transparency
from ..data.framing import SIZE

EXTENT = 44  # mean length of the object's longer side in the training data, in pixels
_LOWER = 1.5  # mean distance of the object's centre below the image's centre in the training data, in pixels
_MOST_PIXELS = 2048  # larger pictures are scaled down: their details are lost at 64 pixels anyway
_LEAST_OBJECT = 8  # pixels
_SHADOW_SEARCHED = 192  # shadows are searched in a picture of this larger side in pixels
_MIDDLE = (0.06, 0.06, 0.94, 0.94)  # box around the object in front of a busy background, as shares of the sides
_LEAST_INSIDE = 0.3  # share of a mask that does not touch the border, above which only that is the object
_SIMILAR = 0.4  # area of a component, relative to the largest one, above which it may be another object
_FAINT = 0.875  # median level, relative to the background, above which it is no shadow but a pale object
_HUE, _EDGE = 0.03, 0.09  # of a shadow: tint and steepest step, relative to the background
_DARKEST = 0.01  # least brightness of a background by which levels are divided


def cut_out(image: Tensor, mask: Tensor | None = None) -> Tensor:
    """Cut the object out of a picture [H, W, 3 or 4] in [0, 1]: RGBA [4, H, W] float32; colours are not multiplied.

    Pictures larger than 2048 pixels are scaled down; specks are dropped. Without a mask [H, W] in [0, 1] of the same
    aspect ratio, the alpha channel is used; and without that, the difference from a plain background; or, with a
    UserWarning, the part of the picture's middle that differs from its border. ValueError: The picture shows no object,
    or only the object.
    """
    image = limit_size(image, _MOST_PIXELS)
    rgb = image[..., :3].permute(2, 0, 1)
    height, width = rgb.shape[1:]
    if mask is not None:
        if abs(mask.shape[0] * width - mask.shape[1] * height) > SAME_SHAPE * width * mask.shape[0]:
            raise ValueError(
                f"mask: expected the shape of the image, {width} x {height}, got {mask.shape[1]} x {mask.shape[0]}"
            )
        alpha = resize(mask[None], (height, width))[0]
    else:
        found = transparency(image)
        alpha = _without_background(image) if found is None else found
    if float(alpha.max()) < 0.5:
        raise ValueError("expected an object, got a picture without one")
    if float(alpha.min()) > 0.5:
        raise ValueError("expected background around the object, got a mask that covers the whole picture")
    alpha = remove_specks(alpha)
    if mask is None:
        areas = torch.bincount(label_components(alpha > 0.5).flatten())[1:].sort(descending=True).values
        if len(areas) > 1 and int(areas[1]) > _SIMILAR * int(areas[0]):
            warn("image: its separate parts are taken for one object (a box or a mask shows only one of several)")
    return torch.cat((rgb, alpha[None]))


def _without_background(image: Tensor) -> Tensor:
    """Find the mask of an opaque picture [H, W, 3 or 4]."""
    try:
        return _inside(_without_shadow(image[..., :3].permute(2, 0, 1), plain_background_mask(image)))
    except BusyBackground:
        warn(
            "image: no plain background; the object is taken to be what differs from the border (give a box or a mask)"
        )
        return box_mask(image, _MIDDLE)


def _inside(alpha: Tensor) -> Tensor:
    """Remove parts of a mask [H, W] that touch the border, such as a horizon, if enough is left that does not."""
    mask = alpha > 0.5
    touching = at_border(label_components(mask))
    return (
        torch.where(touching, 0.0, alpha) if int((mask & ~touching).sum()) > _LEAST_INSIDE * int(mask.sum()) else alpha
    )


def _without_shadow(rgb: Tensor, alpha: Tensor) -> Tensor:
    """Remove parts of a mask [H, W] that have the background's hue and merge with it at the rim without an edge."""
    if not bool((alpha < 0.5).any()):
        return alpha
    height, width = alpha.shape
    scale = min(1.0, _SHADOW_SEARCHED / max(height, width))
    size = max(3, round(scale * height)), max(3, round(scale * width))
    small = F.avg_pool2d(F.interpolate(rgb[None], size, mode="bilinear", antialias=True), 3, 1, 1)[0]
    empty = resize(alpha[None], size)[0] < 0.5
    light = small / small[:, empty].mean(1)[:, None, None].clamp(min=_DARKEST)
    level = light.mean(0)
    steep = (F.max_pool2d(level[None], 3, 1, 1) + F.max_pool2d(-level[None], 3, 1, 1))[0]
    gray = (light - level).abs().amax(0) < _HUE
    joined = at_border(label_components(empty | (gray & (steep < _EDGE) & (level < 1))))
    shadow = joined & ~empty
    if not bool(shadow.any()) or float(level[shadow].median()) > _FAINT:
        return alpha
    return alpha * (1 - resize(joined.float()[None], (height, width))[0])


def frame_object(rgba: Tensor, extent: float = EXTENT) -> Tensor:
    """Scale and move a cut-out object to the size and place of objects in the training data: [4, 64, 64] uint8.

    Its longer side gets ``extent`` pixels; in the training data it has 30 to 59, depending on the shape (see
    `predict.best_frame`). ValueError: The object is smaller than 8 pixels.
    """
    rows, columns = (np.flatnonzero((rgba[3] > 0.5).any(axis).numpy()) for axis in (1, 0))
    if not len(rows):
        raise ValueError("expected an object, got a picture without one")
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    found = max(bottom - top, right - left)
    if found < _LEAST_OBJECT:
        raise ValueError(f"expected an object of at least {_LEAST_OBJECT} pixels, got one of {found}")
    side = found * SIZE / extent
    center = torch.tensor([(left + right) / 2, (top + bottom) / 2 - _LOWER * side / SIZE])
    # Colours are multiplied by alpha, so that the background does not bleed in. Shrinking first avoids aliasing.
    pixels = torch.cat((rgba[:3] * rgba[3:], rgba[3:]))
    scale = min(1.0, 2 * SIZE / float(side))
    size = [max(1, round(scale * n)) for n in pixels.shape[1:]]
    small = F.interpolate(pixels[None], size, mode="bilinear", antialias=scale < 1, align_corners=False)
    place = (torch.arange(2 * SIZE) + 0.5) / (2 * SIZE) - 0.5
    y, x = torch.meshgrid(place * side + center[1], place * side + center[0], indexing="ij")
    grid = torch.stack((2 * x / rgba.shape[2] - 1, 2 * y / rgba.shape[1] - 1), -1).float()
    sampled = F.grid_sample(small, grid[None], padding_mode="zeros", align_corners=False)
    pixels = F.avg_pool2d(sampled, 2)[0].clamp(0, 1)
    pixels = pixels * (pixels[3:] > 0.5 / 255)
    colors = (pixels[:3] / pixels[3:].clamp(min=1e-6)).clamp(0, 1)
    return (torch.cat((colors, pixels[3:])) * 255 + 0.5).to(torch.uint8)
