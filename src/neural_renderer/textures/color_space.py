"""Conversion between display values (sRGB) and linear light."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..raster.warp.registration import sum_of


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


def tinted(color: Tensor, factor: Tensor) -> Tensor:
    """Multiply display values [..., 3] in [0, 1] by a factor of linear light, [3] or [..., 3]; differentiable."""
    if torch.compiler.is_compiling():  # which fuses the operations
        return _Tinted.forward(color, factor)
    result: Tensor = _Tinted.apply(color, factor)  # type: ignore[no-untyped-call]
    return result


class _Tinted(torch.autograd.Function):
    """Tint whose derivatives are two images, rather than a dozen operations that forward mode repeats by direction."""

    generate_vmap_rule = True

    @staticmethod
    def forward(color: Tensor, factor: Tensor) -> Tensor:
        return linear_to_srgb(srgb_to_linear(color) * factor)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, grad: Tensor | None) -> tuple[Tensor | None, Tensor | None]:
        if grad is None:
            return None, None
        by_color, by_factor = _slopes(*ctx.saved_tensors)
        color, factor = ctx.needs_input_grad
        return (
            grad * by_color if color else None,
            (grad * by_factor).sum_to_size(ctx.saved_tensors[1].shape) if factor else None,
        )

    @staticmethod
    def jvp(ctx: Any, to_color: Tensor | None, to_factor: Tensor | None) -> Tensor | None:
        changes = zip((to_color, to_factor), _slopes(*ctx.saved_tensors), strict=True)
        return sum_of([change * slope for change, slope in changes if change is not None])


def _slopes(color: Tensor, factor: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the derivatives of `tinted` by the colour and by the factor, which are differentiable, too."""
    linear = srgb_to_linear(color)
    light = linear * factor
    to_linear = torch.where(color <= 0.04045, 1 / 12.92, 2.4 * linear / (color.clamp(min=0.04) + 0.055))
    shown = (linear_to_srgb(light) + 0.055) / (2.4 * light.clamp(min=0.003))
    to_srgb = torch.where(light <= 0.0031308, 12.92, shown)
    return to_srgb * factor * to_linear, to_srgb * linear


def _check(color: Tensor) -> None:
    if not isinstance(color, Tensor) or not color.is_floating_point():
        raise TypeError(f"color: expected a floating tensor, got {getattr(color, 'dtype', type(color).__name__)}")
    validate.dense("color", color)
