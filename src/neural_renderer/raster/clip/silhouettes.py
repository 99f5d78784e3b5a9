"""Analytic anti-aliasing of silhouettes, whose gradient moves vertices.

Source: Laine et al., "Modular primitives for high-performance differentiable rendering", 2020, on antialiasing.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from ..warp.registration import differentiable, fake, gradient_of, gradient_shape, operator, save_inputs, saved_inputs
from .triangles import clip_mesh, owner_tasks

_KERNELS = Kernels(__name__, "silhouettes.h")
_Silhouettes, _FindShares = _KERNELS.struct("Silhouettes"), _KERNELS.struct("FindShares")
_BlendPixels, _BlendPixelsBackward = _KERNELS.struct("BlendPixels"), _KERNELS.struct("BlendPixelsBackward")
_find_shares = _KERNELS.kernel("find_shares", _FindShares)
_blend_pixels = _KERNELS.kernel("blend_pixels", _BlendPixels)
_blend_colors_backward = _KERNELS.kernel("blend_colors_backward", _BlendPixelsBackward)
_blend_positions_backward = _KERNELS.kernel("blend_positions_backward", _BlendPixelsBackward)


@operator
def blend_silhouettes(
    colors: Tensor, rast: Tensor, positions: Tensor, triangles: Tensor, siblings: Tensor, boost: float
) -> tuple[Tensor, Tensor]:
    """Blend adjacent pixels at silhouettes; differentiable in colours and positions.

    Args:
        colors: [B, H, W, C] float32, row 0 at the bottom.
        rast: As from `show_triangles`, [B, H, W, 4] float32.
        positions: Vertices (x, y, z, w) in clip space, [B or 1, V, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        siblings: As from `find_half_edges`, [1, F, 3] int32.
        boost: Factor of the gradient to positions.

    Returns:
        The image, [B, H, W, C] float32. The share by which each pixel blends with the one to the right and the one
        above, [B, H, W, 2] float32.
    """
    batch, height, width, channels = colors.shape
    device = colors.device
    tasks, each = pixel_tasks(batch * height, width, device)
    least = worth_a_thread(each * width)
    mesh = clip_mesh(positions, triangles, batch, height, width)
    of = _Silhouettes(mesh=mesh, rast=rast, siblings=siblings, each=each)
    shares = empty((batch, height, width, 2), device)
    launch(_find_shares, tasks, [_FindShares(of=of, shares=shares)], device, least)
    result = empty(colors.shape, device)
    call = _BlendPixels(of=of, shares=shares, colors=colors, channels=channels, result=result)
    launch(_blend_pixels, tasks, [call], device, least)
    return result, shares


@fake(blend_silhouettes)
def _(colors: Tensor) -> tuple[Tensor, Tensor]:
    return colors.new_empty(colors.shape), colors.new_empty((*colors.shape[:3], 2))


@gradient_of(blend_silhouettes, "colors", "positions", once=True)
def blend_silhouettes_backward(
    grad: Tensor, shares: Tensor, positions_too: bool, *inputs: Any
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `blend_silhouettes` to colours, and to positions (empty if not ``positions_too``)."""
    colors, rast, positions, triangles, siblings, boost = inputs
    batch, height, width, channels = colors.shape
    device = colors.device
    to_colors = empty(colors.shape, device)
    to_positions = zeros(gradient_shape(positions, positions_too), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    fields = {
        "shares": shares,
        "colors": colors,
        "channels": channels,
        "grad": grad,
        "boost": boost,
        "to_colors": to_colors,
        "to_positions": to_positions,
    }
    mesh = clip_mesh(positions, triangles, batch, height, width)
    of = {"mesh": mesh, "rast": rast, "siblings": siblings}
    call = _BlendPixelsBackward(of=_Silhouettes(**of, each=each), **fields)
    launch(_blend_colors_backward, tasks, [call], device, worth_a_thread(each * width))
    if positions_too:
        tasks, each = owner_tasks(positions.shape[0], batch, height, width, device)
        call = _BlendPixelsBackward(of=_Silhouettes(**of, each=each), **fields)
        launch(_blend_positions_backward, tasks, [call], device, worth_a_thread(each * width))
    return to_colors, to_positions


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    save_inputs(ctx, (output[1], *inputs), output)
    ctx.set_materialize_grads(False)


def _to_inputs(ctx: Any, grad: Tensor | None, _: Any) -> Any:
    if grad is None:
        return {}
    shares, *inputs = saved_inputs(ctx)
    results = blend_silhouettes_backward(grad, shares, ctx.needs_input_grad[2], *inputs)
    return dict(zip(("colors", "positions"), results, strict=True))


differentiable(blend_silhouettes, _to_inputs, _save)
