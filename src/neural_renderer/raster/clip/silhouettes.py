"""Analytic anti-aliasing of silhouettes, whose gradient moves vertices.

Source: Laine et al., "Modular primitives for high-performance differentiable rendering", 2020, on antialiasing.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, gradient_of, gradient_shape, operator, save_inputs, saved_inputs
from .triangles import clip_mesh, owner_tasks

_KERNELS = Kernels(__name__, "silhouettes.h")
_Silhouettes = _KERNELS.struct("Silhouettes")
_BlendPixels, _BlendPixelsBackward = _KERNELS.struct("BlendPixels"), _KERNELS.struct("BlendPixelsBackward")
_blend_pixels = _KERNELS.kernel("blend_pixels", _BlendPixels)
_blend_pixels_backward = _KERNELS.kernel("blend_pixels_backward", _BlendPixelsBackward)


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
    of = _silhouettes(each, colors, rast, positions, triangles, siblings)
    result, shares = empty(colors.shape, device), empty((batch, height, width, 2), device)
    call = _BlendPixels(of=of, colors=colors, channels=channels, result=result, shares=shares)
    launch(_blend_pixels, tasks, [call], device, worth_a_thread(each * width))
    return result, shares


@fake(blend_silhouettes)
def _(colors: Tensor) -> tuple[Tensor, Tensor]:
    return colors.new_empty(colors.shape), colors.new_empty((*colors.shape[:3], 2))


@gradient_of(blend_silhouettes, "colors", "positions", once=True)
def blend_silhouettes_backward(
    grad: Tensor, shares: Tensor, positions_too: bool, *inputs: Any
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `blend_silhouettes` to colours, and to positions (empty if not ``positions_too``)."""
    colors, _, positions, _, _, boost = inputs
    batch, height, width, channels = colors.shape
    device = colors.device
    to_colors = empty(colors.shape, device)
    to_positions = zeros(gradient_shape(positions, positions_too), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    call = _BlendPixelsBackward(
        of=_silhouettes(each, *inputs[:-1]),
        shares=shares,
        colors=colors,
        channels=channels,
        grad=grad,
        boost=boost,
        to_colors=to_colors,
        to_positions=to_positions if positions_too else None,
    )
    apart = positions_too and not in_any_order(device)
    if apart:
        call.to_positions = None
    launch(_blend_pixels_backward, tasks, [call], device, worth_a_thread(each * width))
    if apart:
        tasks, each = owner_tasks(positions.shape[0], batch, height, width, device)
        call.of.each, call.to_colors, call.to_positions = each, None, to_positions.data_ptr()
        launch(_blend_pixels_backward, tasks, [call], device, worth_a_thread(each * width))
    return to_colors, to_positions


def _silhouettes(each: int, *inputs: Any) -> Call:
    """Make the `Silhouettes` of kernels from the inputs of `blend_silhouettes`, for tasks of ``each`` rows."""
    colors, rast, positions, triangles, siblings = inputs
    mesh = clip_mesh(positions, triangles, *colors.shape[:3])
    return _Silhouettes(mesh=mesh, rast=rast, siblings=siblings, each=each)


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
