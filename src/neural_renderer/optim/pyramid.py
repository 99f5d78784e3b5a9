"""Image pyramids as residuals."""

from __future__ import annotations

from typing import Any

from torch import Tensor
from torch.nn import functional

from ..base import validate


def pyramid(images: Tensor, levels: int, *, skip: int = 0) -> list[Tensor]:
    """Average images over blocks of 1, 2², 4², … pixels, for residuals at several scales.

    Derivatives of coarse levels hold for longer motions. All levels have equal weight: means of 4ᵏ pixels are
    multiplied by 2ᵏ, because there are fewer.

    Args:
        images: [..., H, W] floating: for example the difference of two images.
        levels: Number of levels, at least 1. The pyramid ends before a side is shorter than 1 pixel.
        skip: Number of finest levels to leave out. A difference of images drawn at 2 or 4 times the size, less one or
            two levels, is averaged over 4 or 16 sub-pixel shifts. This also averages its derivatives and reduces their
            noise: worth its time where faces are smaller than a pixel.

    Returns:
        The levels, from fine to coarse, [..., H / 2ᵏ, W / 2ᵏ]; odd sides lose their last row or column.

    Raises:
        TypeError, ValueError: ``images`` are no floating images, or a number is out of range.

    Example:
        >>> drawn, photo = torch.rand(2, 1, 3, 64, 64)
        >>> [tuple(level.shape) for level in nr.optim.pyramid(drawn - photo, 3)]
        [(1, 3, 64, 64), (1, 3, 32, 32), (1, 3, 16, 16)]
    """
    validate.floating("images", images, _shape(images))
    levels, skip = validate.whole("levels", levels, 1), validate.whole("skip", skip, 0)
    result = []
    for level in range(skip + levels):
        if level:
            if min(images.shape[-2:]) < 2:
                break
            flat = images.reshape(-1, 1, *images.shape[-2:])
            images = 2 * functional.avg_pool2d(flat, 2).reshape(
                *images.shape[:-2], *(n // 2 for n in images.shape[-2:])
            )
        if level >= skip:
            result.append(images)
    return result


def _shape(images: Any) -> tuple[str, ...]:
    return (*("N" * max(0, getattr(images, "ndim", 2) - 2)), "H", "W")
