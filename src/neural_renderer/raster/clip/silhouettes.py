"""Analytic anti-aliasing of silhouettes, whose gradient moves vertices.

Source: Laine et al., "Modular primitives for high-performance differentiable rendering", 2020, on antialiasing.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import concurrent, in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from ..warp.registration import differentiable, fake, gradient_of, gradient_shape, operator, save_inputs, saved_inputs
from .triangles import clip_mesh, owner_tasks

_KERNELS = Kernels(__name__, "silhouettes.h")
_FindSilhouettes, _Silhouettes = _KERNELS.struct("FindSilhouettes"), _KERNELS.struct("Silhouettes")
_BlendPixels, _BlendPixelsBackward = _KERNELS.struct("BlendPixels"), _KERNELS.struct("BlendPixelsBackward")
_find_silhouettes = _KERNELS.kernel("find_silhouettes", _FindSilhouettes)
_find_shares, _find_and_blend = (_KERNELS.kernel(name, _BlendPixels) for name in ("find_shares", "find_and_blend"))
_blend_pixels = _KERNELS.kernel("blend_pixels", _BlendPixels)
_blend_pixels_backward = _KERNELS.kernel("blend_pixels_backward", _BlendPixelsBackward)


@operator
def blend_silhouettes(
    colors: Tensor, rast: Tensor, positions: Tensor, triangles: Tensor, siblings: Tensor, boost: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Blend adjacent pixels at silhouettes; differentiable in colours and positions.

    Args:
        colors: [B, H, W, C] float32, row 0 at the bottom.
        rast: As from `show_triangles`, [B, H, W, 4] float32.
        positions: Vertices (x, y, z, w) in clip space, [B or 1, V, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        siblings: As from `find_half_edges`, [1, F, 3] int32.
        boost: Factor of the gradient to positions.

    Returns:
        The image, [B, H, W, C] float32. The silhouettes, one bit for each edge of a triangle, [B, F] int32. The share
        by which each pixel blends with the one to the right and the one above, [B, H, W, 2] float32.
    """
    batch, height, width, channels = colors.shape
    device = colors.device
    count = triangles.shape[0]
    mesh = clip_mesh(positions, triangles, batch, height, width)
    silhouettes = empty((batch, count), device, torch.int32)
    search = _FindSilhouettes(mesh=mesh, siblings=siblings, silhouettes=silhouettes)
    launch(_find_silhouettes, batch * count, [search], device, worth_a_thread(32))
    tasks, each = pixel_tasks(batch * height, width, device)
    of = _Silhouettes(mesh=mesh, rast=rast, silhouettes=silhouettes, each=each)
    result, shares = empty(colors.shape, device), empty((batch, height, width, 2), device)
    call = _BlendPixels(of=of, colors=colors, channels=channels, result=result, shares=shares)
    # On the CPU, finding a share twice takes longer than a launch.
    for kernel in (_find_and_blend,) if concurrent(device) else (_find_shares, _blend_pixels):
        launch(kernel, tasks, [call], device, worth_a_thread(each * width))
    return result, silhouettes, shares


@fake(blend_silhouettes)
def _(colors: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return (
        colors.new_empty(colors.shape),
        triangles.new_empty((colors.shape[0], triangles.shape[0])),
        colors.new_empty((*colors.shape[:3], 2)),
    )


@gradient_of(blend_silhouettes, "colors", "positions", once=True, leave_out="siblings")
def blend_silhouettes_backward(
    grad: Tensor, silhouettes: Tensor, shares: Tensor, positions_too: bool, *inputs: Any
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `blend_silhouettes` to colours, and to positions (empty if not ``positions_too``)."""
    colors, rast, positions, triangles, boost = inputs
    batch, height, width, channels = colors.shape
    device = colors.device
    to_colors = empty(colors.shape, device)
    to_positions = zeros(gradient_shape(positions, positions_too), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    mesh = clip_mesh(positions, triangles, batch, height, width)
    call = _BlendPixelsBackward(
        of=_Silhouettes(mesh=mesh, rast=rast, silhouettes=silhouettes, each=each),
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


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    *others, _, boost = inputs  # without siblings
    save_inputs(ctx, (*output[1:], *others, boost), output)
    ctx.set_materialize_grads(False)


def _to_inputs(ctx: Any, grad: Tensor | None, *_: Any) -> Any:
    if grad is None:
        return {}
    silhouettes, shares, *inputs = saved_inputs(ctx)
    results = blend_silhouettes_backward(grad, silhouettes, shares, ctx.needs_input_grad[2], *inputs)
    return dict(zip(("colors", "positions"), results, strict=True))


differentiable(blend_silhouettes, _to_inputs, _save)
