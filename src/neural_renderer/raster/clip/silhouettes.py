"""Anti-aliasing of silhouettes, whose gradient moves vertices (Laine et al., "Modular primitives for high-performance
differentiable rendering", 2020)."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, differentiable_once, fake, operator
from .triangles import clip_mesh, owner_tasks

_KERNELS = Kernels(__name__, "silhouettes.h")
_FindSilhouettes, _Silhouettes = _KERNELS.struct("FindSilhouettes"), _KERNELS.struct("Silhouettes")
_BlendSilhouettes = _KERNELS.struct("BlendSilhouettes")
_BlendSilhouettesBackward = _KERNELS.struct("BlendSilhouettesBackward")
_find_silhouettes = _KERNELS.kernel("find_silhouettes", _FindSilhouettes)
_blend_silhouettes = _KERNELS.kernel("blend_silhouettes", _BlendSilhouettes)
_blend_colors_backward = _KERNELS.kernel("blend_colors_backward", _BlendSilhouettesBackward)
_blend_positions_backward = _KERNELS.kernel("blend_positions_backward", _BlendSilhouettesBackward)


@operator
def blend_silhouettes(
    colors: Tensor, rast: Tensor, positions: Tensor, triangles: Tensor, rings: Tensor, boost: float
) -> Tensor:
    """Blend adjacent pixels at silhouettes; differentiable in colours and positions.

    Args:
        colors: [B, H, W, C] float32, row 0 at the bottom.
        rast: As from `show_triangles`, [B, H, W, 4] float32.
        positions: Vertices (x, y, z, w) in clip space, [B or 1, V, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        rings: As from `edge_rings`, [1, F, 3] int32.
        boost: Factor of the gradient to positions.

    Returns:
        [B, H, W, C] float32.
    """
    result = empty(colors.shape, colors.device)
    tasks, each = pixel_tasks(colors.shape[0] * colors.shape[1], colors.shape[2], colors.device)
    call = _BlendSilhouettes(of=_of(colors, rast, positions, triangles, rings, each), result=result)
    launch(_blend_silhouettes, tasks, [call], colors.device, worth_a_thread(each * colors.shape[2]))
    return result


@fake(blend_silhouettes)
def _(colors: Tensor) -> Tensor:
    return colors.new_empty(colors.shape)


@differentiable_once
def blend_silhouettes_backward(
    grad: Tensor,
    colors: Tensor,
    rast: Tensor,
    positions: Tensor,
    triangles: Tensor,
    rings: Tensor,
    boost: float,
    positions_too: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `blend_silhouettes` to colours, and to positions (empty if not ``positions_too``)."""
    batch, height, width, _ = colors.shape
    device = colors.device
    to_colors = empty(colors.shape, device)
    to_positions = zeros(positions.shape if positions_too else (0, 0, 4), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    fields = {"grad": grad.contiguous(), "boost": boost, "to_colors": to_colors, "to_positions": to_positions}
    of = _of(colors, rast, positions, triangles, rings, each)
    call = _BlendSilhouettesBackward(of=of, **fields)
    launch(_blend_colors_backward, tasks, [call], device, worth_a_thread(each * width))
    if positions_too:
        tasks, of.each = owner_tasks(len(positions), batch, height, width, device)
        call = _BlendSilhouettesBackward(of=of, **fields)
        launch(_blend_positions_backward, tasks, [call], device, worth_a_thread(of.each * width))
    return to_colors, to_positions


@fake(blend_silhouettes_backward)
def _(colors: Tensor, positions: Tensor, positions_too: bool) -> tuple[Tensor, Tensor]:
    return colors.new_empty(colors.shape), positions.new_empty(positions.shape if positions_too else (0, 0, 4))


def _of(colors: Tensor, rast: Tensor, positions: Tensor, triangles: Tensor, rings: Tensor, each: int) -> Call:
    """Find the silhouettes of each image, and make the `Silhouettes` of kernels."""
    batch, height, width, channels = colors.shape
    mesh = clip_mesh(positions, triangles, batch, height, width)
    found = empty((batch, len(triangles)), colors.device, torch.int32)
    search = _FindSilhouettes(mesh=mesh, next=rings.contiguous(), silhouettes=found)
    launch(_find_silhouettes, batch * len(triangles), [search], colors.device, worth_a_thread(32))
    return _Silhouettes(
        mesh=mesh,
        rast=rast.contiguous(),
        silhouettes=found,
        colors=colors.contiguous(),
        channels=channels,
        each=each,
    )


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    *tensors, ctx.boost = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    positions_too = ctx.needs_input_grad[2]
    colors, rast, positions, triangles, rings = ctx.saved_tensors
    to_colors, to_positions = blend_silhouettes_backward(
        grad, colors, rast, positions, triangles, rings, ctx.boost, positions_too
    )
    colors_too = ctx.needs_input_grad[0]
    return to_colors if colors_too else None, None, to_positions if positions_too else None, None, None, None


differentiable(blend_silhouettes, _to_inputs, _save)
