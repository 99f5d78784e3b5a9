"""Samples of images and cube maps at coordinates with a given footprint, from mipmaps."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, differentiable_once, fake, operator, sum_of
from .triangles import owner_tasks

_KERNELS = Kernels(__name__, "texture_levels.h")
_TextureLevels, _Lookups = _KERNELS.struct("TextureLevels"), _KERNELS.struct("Lookups")
_SampleLevels, _SampleLevelsBackward = _KERNELS.struct("SampleLevels"), _KERNELS.struct("SampleLevelsBackward")
_sample_levels = _KERNELS.kernel("sample_levels", _SampleLevels)
_sample_levels_backward = _KERNELS.kernel("sample_levels_backward", _SampleLevelsBackward)

# Their places are their numbers in texture_levels.h.
FILTERS = ("nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear")
BOUNDARIES = ("wrap", "clamp", "zero", "cube")


def smaller_level(image: Tensor) -> Tensor:
    """Average 2 x 2 texels of images [N, h, w, C] of even sides, or of side 1, which stays."""
    height, width = image.shape[1:3]
    window = (2 if height > 1 else 1, 2 if width > 1 else 1)
    return functional.avg_pool2d(image.movedim(3, 1), window).movedim(1, 3)


@operator
def sample_levels(
    texels: Tensor,
    uv: Tensor,
    footprint: Tensor | None,
    bias: Tensor | None,
    size: list[int],
    filter_mode: int,
    boundary: list[int],
) -> Tensor:
    """Sample textures; differentiable in texels, uv, footprint and bias.

    Args:
        texels: All levels, the largest first, each row after row; of a cube map, face after face. [B or 1, T, C]
            float32.
        uv: Coordinates in [0, 1] over the image, (0, 0) at its first texel, or directions, [B, H, W, 2 or 3] float32.
        footprint: Change of each of them by one pixel, right and up in turn, [B, H, W, 4 or 6] float32.
        bias: Added to the level, [B, H, W] float32.
        size: Height and width of the largest level, and number of levels.
        filter_mode: Place in `FILTERS`.
        boundary: Places in `BOUNDARIES` along s and t; both are that of "cube", or neither.

    Returns:
        [B, H, W, C] float32; 0 for directions of length 0.
    """
    batch, height, width, _ = uv.shape
    result = empty((batch, height, width, texels.shape[2]), uv.device)
    tasks, each = pixel_tasks(batch * height, width, uv.device)
    call = _SampleLevels(
        texture=_texture(texels, size, filter_mode, boundary), at=_lookups(uv, footprint, bias, each), result=result
    )
    launch(_sample_levels, tasks, [call], uv.device, worth_a_thread(each * width))
    return result


@fake(sample_levels)
def _(texels: Tensor, uv: Tensor) -> Tensor:
    return uv.new_empty((*uv.shape[:3], texels.shape[2]))


@differentiable_once
def sample_levels_backward(
    grad: Tensor,
    texels: Tensor,
    uv: Tensor,
    footprint: Tensor | None,
    bias: Tensor | None,
    size: list[int],
    filter_mode: int,
    boundary: list[int],
    texels_too: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the gradients to texels, uv, footprint and bias; empty if not ``texels_too`` or where there is none."""
    batch, height, width, _ = uv.shape
    device = uv.device
    to_texels = zeros(texels.shape if texels_too else (0, 0, 0), device)
    to_uv = zeros(uv.shape, device)
    to_footprint = zeros((0,) if footprint is None else footprint.shape, device)
    to_bias = zeros((0,) if bias is None else bias.shape, device)
    tasks, each = pixel_tasks(batch * height, width, device)
    if texels_too:
        tasks, each = owner_tasks(len(texels), batch, height, width, device)
    call = _SampleLevelsBackward(
        texture=_texture(texels, size, filter_mode, boundary),
        at=_lookups(uv, footprint, bias, each),
        grad=grad.contiguous(),
        texels_too=int(texels_too),
        to_texels=to_texels,
        to_uv=to_uv,
        to_footprint=None if footprint is None else to_footprint,
        to_bias=None if bias is None else to_bias,
    )
    launch(_sample_levels_backward, tasks, [call], device, worth_a_thread(each * width))
    return to_texels, to_uv, to_footprint, to_bias


@fake(sample_levels_backward)
def _(
    texels: Tensor, uv: Tensor, footprint: Tensor | None, bias: Tensor | None, texels_too: bool
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return (
        texels.new_empty(texels.shape if texels_too else (0, 0, 0)),
        uv.new_empty(uv.shape),
        uv.new_empty((0,) if footprint is None else footprint.shape),
        uv.new_empty((0,) if bias is None else bias.shape),
    )


def _texture(texels: Tensor, size: list[int], filter_mode: int, boundary: list[int]) -> Call:
    return _TextureLevels(
        texels=texels.contiguous(),
        total=texels.shape[1],
        owners=len(texels),
        channels=texels.shape[2],
        height=size[0],
        width=size[1],
        levels=size[2],
        filter=filter_mode,
        boundary=boundary[0],
        boundary_t=boundary[1],
    )


def _lookups(uv: Tensor, footprint: Tensor | None, bias: Tensor | None, each: int) -> Call:
    images, height, width, _ = uv.shape
    return _Lookups(
        uv=uv.contiguous(),
        footprint=None if footprint is None else footprint.contiguous(),
        bias=None if bias is None else bias.contiguous(),
        images=images,
        height=height,
        width=width,
        each=each,
    )


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    *tensors, ctx.size, ctx.filter_mode, ctx.boundary = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    needed = ctx.needs_input_grad[:4]
    texels, uv, footprint, bias = ctx.saved_tensors
    results = sample_levels_backward(
        grad, texels, uv, footprint, bias, ctx.size, ctx.filter_mode, ctx.boundary, needed[0]
    )
    return *(result if need else None for result, need in zip(results, needed, strict=True)), None, None, None


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    """Add up the changes by each input. A pixel depends on its own coordinates only: each channel takes a pass back."""
    texels, *others = inputs
    parts = [] if tangents[0] is None else [sample_levels(tangents[0], *others)]
    if any(each is not None for each in tangents[1:4]):
        units = torch.eye(texels.shape[2], device=texels.device).expand(*inputs[1].shape[:3], -1, -1).unbind(3)
        given = [*inputs, False]
        rows = [sample_levels_backward(unit, *given)[1:] for unit in units]
        for tangent, slopes in zip(tangents[1:4], zip(*rows, strict=True), strict=True):
            if tangent is not None:
                slope = torch.stack(slopes, 3)  # [B, H, W, C], or [B, H, W, C, 2 to 6]
                if slope.dim() == 4:
                    parts.append(slope * tangent[..., None])
                else:
                    parts.append((slope * tangent[..., None, :]).sum(-1))
    return sum_of(parts)


differentiable(sample_levels, _to_inputs, _save, _forward)
