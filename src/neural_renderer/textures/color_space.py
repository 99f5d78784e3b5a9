"""Products of display values (sRGB) and linear factors."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..base.color_space import linear_to_srgb, srgb_to_linear
from ..raster.warp.registration import sum_of


def tinted(color: Tensor, factor: Tensor) -> Tensor:
    """Multiply display values [..., 3] in [0, 1] by a linear factor, [3] or [..., 3]; differentiable."""
    if torch.compiler.is_compiling():  # it fuses the operations
        return _Tinted.forward(color, factor)
    result: Tensor = _Tinted.apply(color, factor)  # type: ignore[no-untyped-call]
    return result


class _Tinted(torch.autograd.Function):
    """`tinted` with its two derivatives as images, not a dozen operations that forward mode repeats per tangent."""

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
