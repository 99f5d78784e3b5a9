"""Conversion between display values (sRGB) and linear light."""

from __future__ import annotations

import torch
from torch import Tensor

from . import validate


def srgb_to_linear(color: Tensor) -> Tensor:
    """Convert display values to linear light: c / 12.92 below 0.04045, else ((c + 0.055) / 1.055)^2.4 (IEC 61966-2-1).

    Args:
        color: Any shape, floating, in [0, 1]; larger values follow the same curve, negative ones its straight part.

    Returns:
        The same shape, differentiable.

    Raises:
        TypeError: ``color`` is not a floating tensor.

    Example:
        >>> srgb_to_linear(torch.tensor([0.0, 0.5, 1.0]))
        tensor([0.0000, 0.2140, 1.0000])
    """
    _check(color)
    return torch.where(color <= 0.04045, color / 12.92, ((color.clamp(min=0.04) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(color: Tensor) -> Tensor:
    """Convert linear light to display values: 12.92 c below 0.0031308, else 1.055 c^(1 / 2.4) − 0.055 (IEC 61966-2-1).

    Args:
        color: Any shape, floating, in [0, 1]; larger values follow the same curve, without tone mapping.

    Returns:
        The same shape, differentiable.

    Raises:
        TypeError: ``color`` is not a floating tensor.

    Example:
        >>> linear_to_srgb(torch.tensor([0.0, 0.2140, 1.0]))
        tensor([0.0000, 0.5000, 1.0000])
    """
    _check(color)
    return torch.where(color <= 0.0031308, 12.92 * color, 1.055 * color.clamp(min=0.003) ** (1 / 2.4) - 0.055)


def _check(color: Tensor) -> None:
    if not isinstance(color, Tensor) or not color.is_floating_point():
        raise TypeError(f"color: expected a floating tensor, got {getattr(color, 'dtype', type(color).__name__)}")
    validate.dense("color", color)
