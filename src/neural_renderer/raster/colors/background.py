"""Backgrounds as kernels read them."""

from __future__ import annotations

from torch import Tensor

from ..warp.native import Call, struct

_Background = struct("background.h", "Background")


def background_of(background: Tensor) -> Call:
    """Make the `Background` of kernels: [B, C, H, W] float32 with any strides, which stays where it is in memory."""
    if background.numel() == 0:
        return _Background()
    image, channel, row, column = background.stride()
    # A view of the first number alone is contiguous.
    first = background.as_strided((), ())
    return _Background(values=first, image=image, channel=channel, row=row, column=column)
