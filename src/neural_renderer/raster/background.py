"""Background: a number, a colour or an image."""

from __future__ import annotations

import reprlib
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from ..base import validate
from ..base.constants import constant
from ..io.images import as_image
from .settings import Settings
from .warp.elementwise import joined


def background_image(
    background: Any,
    batch: int,
    channels: int,
    settings: Settings,
    device: torch.device,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Check a background of B images, and bring it to a shape that broadcasts to the images before anti-aliasing.

    Args:
        background: Number; colour [C] or [B, C]; or image [C, height, width] or [height, width, C], or a batch of them,
            of the size that is returned. If both layouts fit, channels come first. Array-likes and images of Pillow are
            converted. uint8 is refused: its numbers are in [0, 255].

    Returns:
        [1 or B, C, 1 or H, 1 or W] of ``dtype``, with H and W twice the returned size under anti-aliasing.

    Raises TypeError without numbers of a right type, and ValueError for other shapes, NaN and infinity.
    """
    height, width = settings.height, settings.width
    if str(getattr(background, "dtype", "")).endswith("uint8"):  # most likely an image from a file
        raise TypeError(f"background: expected numbers in [0, 1], got {validate.shape_of(background)}")
    if isinstance(background, Image.Image):
        background = as_image("background", background)
    known = None if isinstance(background, Tensor) else constant(background, dtype, device)  # which is finite
    if known is None and not isinstance(background, Tensor):
        try:
            background = torch.as_tensor(background, dtype=dtype, device=device)
        except (TypeError, ValueError, RuntimeError, OverflowError):
            raise TypeError(
                f"background: expected a number, a colour [{channels}] or [B, {channels}], or an image, "
                f"got {reprlib.repr(background)}"
            ) from None
    if known is None:
        validate.dense("background", background)
        if device.type != "meta":
            validate.has_numbers("background", background)
        known = background.to(device=device, dtype=dtype)
        validate.finite("background", known)
    color = known.expand(channels) if known.dim() == 0 else known
    shape = tuple(color.shape)
    image = (channels, height, width)
    if shape[-3:] == (height, width, channels) and shape[-3:] != image:
        color = color.movedim(-1, -3)
        shape = tuple(color.shape)
    if shape == (channels,) or (len(shape) == 2 and shape[0] in (1, batch) and shape[1] == channels):
        return color.reshape(-1, channels, 1, 1)
    if shape == image or (len(shape) == 4 and shape[0] in (1, batch) and shape[1:] == image):
        color = color.reshape(-1, *image)
        if not settings.anti_aliasing:
            return color
        blocks = color[:, :, :, None, :, None].expand(-1, -1, -1, 2, -1, 2)
        return joined((blocks,), 0).flatten(4).flatten(2, 3)
    hint = "; background[..., :3] is without transparency" if (channels, shape[-1:]) == (3, (4,)) else ""
    raise ValueError(
        f"background: expected a number, [{channels}], [{batch}, {channels}], {list(image)}, "
        f"{[height, width, channels]} or a batch of {batch} of these, got {list(shape)}{hint}"
    )
