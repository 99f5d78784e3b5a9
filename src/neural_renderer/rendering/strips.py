"""Rendering of images larger than the memory in strips of rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from ..base import private
from ..raster.background import background_image
from ..raster.outputs import Images
from ..raster.settings import Settings
from ..raster.warp.registration import needs_gradient

Draw: TypeAlias = Callable[[Settings, Any], Images]
"""Function that draws the images of settings over a background."""

# Padding: rows that are rendered above and below a strip, then cropped. Mipmap levels depend on the next pixel. The
# gradient through visibility reads the next two pixels, faces thinner than a pixel behind them, and texture seams up to
# the centres of adjacent faces.
_PADDING, _PADDING_WITH_GRADIENT = 2, 16
_MARGIN = 2  # rows above and below a mesh, for rounding


def drawn_strips(
    draw: Draw, settings: Settings, background: Any, batch: int, device: torch.device, tile: int
) -> Iterator[Images]:
    """Draw ``batch`` images of ``settings`` in strips of about tile² pixels, from the top.

    The background is as in `background_image`. Each strip has the whole width.
    """
    whole = background_image(background, batch, 3, replace(settings, anti_aliasing=False), device)
    is_image = whole.shape[2:] == (settings.height, settings.width)
    rows = max(1, tile * tile // settings.width)
    differentiates = torch.is_grad_enabled() or private.may_have_tangents()  # forward mode works under no_grad, too
    padding = _PADDING_WITH_GRADIENT if differentiates else _PADDING
    for first in range(0, settings.height, rows):
        last = min(first + rows, settings.height)
        begin, end = max(first - padding, 0), min(last + padding, settings.height)
        images = draw(settings.strip(begin, end), whole[:, :, begin:end] if is_image else whole.flatten(1))
        crop = slice(first - begin, last - begin)
        # Copies, so that the padding is freed.
        yield Images(**{name: image[..., crop, :].clone() for name, image in vars(images).items()})


def drawn_whole(draw: Draw, settings: Settings, background: Any, corners: Tensor, tile: int) -> Images:
    """Draw the images of corners [B, F, 3, 3] strip by strip, as `drawn_strips`; backward draws each strip again.

    Transformations of `torch.func` allow no checkpoints: inside them, the intermediate results of all strips are kept.
    """
    if needs_gradient(corners) and not settings.gradient.is_local:
        raise ValueError(f"tile: expected None with the gradient {settings.gradient!r}, got {tile}")

    def checkpointed(settings: Settings, background: Any) -> Images:
        from torch.utils.checkpoint import checkpoint

        images = checkpoint(lambda: vars(draw(settings, background)), use_reentrant=False, preserve_rng_state=False)
        return Images(**images)

    draw_strip = checkpointed if torch.is_grad_enabled() and not private.transforms_active() else draw
    strips = [
        vars(images) for images in drawn_strips(draw_strip, settings, background, len(corners), corners.device, tile)
    ]
    return Images(**{name: torch.cat([strip[name] for strip in strips], -2) for name in strips[0]})


def rows_with(corners: Tensor, settings: Settings) -> slice:
    """Find rows of images that contain all faces, of corners [B, F, 3, 3]; all rows if a corner is behind the eye."""
    if corners.numel() == 0 or not corners[..., 2].min() > 0:
        return slice(0, settings.height)
    low, high = corners[..., 1].aminmax()
    first, last = ((1 - y.item()) / 2 * settings.height for y in (high, low))
    middle = settings.height // 2  # a mesh outside of the image leaves one row
    start = min(max(math.floor(first) - _MARGIN, 0), middle)
    return slice(start, max(min(math.ceil(last) + _MARGIN, settings.height), middle + 1))
