"""Sampling of images and cube maps from mipmaps, with given footprints."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..warp import registration
from ..warp.launch import launch
from ..warp.layout import concurrent, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels, constant
from .triangles import owner_tasks

_KERNELS = Kernels(__name__, "texture_levels.h")
_TextureLevels, _Lookups = _KERNELS.struct("TextureLevels"), _KERNELS.struct("Lookups")
_SampleLevels, _SampleLevelsBackward = _KERNELS.struct("SampleLevels"), _KERNELS.struct("SampleLevelsBackward")
_HalveLevels, _HalveLevelsBackward = _KERNELS.struct("HalveLevels"), _KERNELS.struct("HalveLevelsBackward")
_halve_levels = _KERNELS.kernel("halve_levels", _HalveLevels)
_halve_levels_backward = _KERNELS.kernel("halve_levels_backward", _HalveLevelsBackward)
_sample_levels = _KERNELS.kernel("sample_levels", _SampleLevels)
_sample_levels_backward = _KERNELS.kernel("sample_levels_backward", _SampleLevelsBackward)

FILTERS = {
    "nearest": constant("texture_levels.h", "FILTER_NEAREST"),
    "linear": constant("texture_levels.h", "FILTER_LINEAR"),
    "linear-mipmap-nearest": constant("texture_levels.h", "FILTER_NEAREST_LEVEL"),
    "linear-mipmap-linear": constant("texture_levels.h", "FILTER_LINEAR_LEVELS"),
}
BOUNDARIES = {name: constant("texel_pair.h", name.upper()) for name in ("wrap", "clamp", "zero", "cube")}


def level_sizes(height: int, width: int, count: int) -> list[tuple[int, int]]:
    """List the height and width of ``count`` levels, the largest first; a side of 1 stays."""
    return [(max(height >> level, 1), max(width >> level, 1)) for level in range(count)]


@registration.operator
def halve_levels(images: Tensor, count: int) -> Tensor:
    """Average blocks of 2 x 2 texels, again and again, to ``count`` levels; differentiable.

    Args:
        images: The largest level, [B, S, h, w, C] float32; S is 6 for a cube map, else 1. The sides of all levels but
            the last are even or 1.

    Returns:
        ``texels`` of `sample_levels`, [B, T, C].
    """
    owners, sides, height, width, channels = images.shape
    texels = empty(_texels_shape(images, count), images.device)
    size = {"owners": owners, "sides": sides, "channels": channels, "height": height, "width": width}
    call = _HalveLevels(images=images, texels=texels, total=texels.shape[1], **size)
    sizes = level_sizes(height, width, count)
    several = 3 if concurrent(images.device) else 1  # levels of a launch: these read a texel for each of them
    for first in range(1, count, several):
        made = sizes[first : first + several]
        tasks = owners * sides * sum(rows * columns for rows, columns in made)
        launch(_halve_levels, tasks, [call], images.device, worth_a_thread(1))
        made = [sizes[first - 1], *made]
        call.before += sides * sum(rows * columns for rows, columns in made[:-1])
        call.images, (call.height, call.width) = None, made[-1]
    return texels


@registration.fake(halve_levels)
def _(images: Tensor, count: int) -> Tensor:
    return images.new_empty(_texels_shape(images, count))


def _texels_shape(images: Tensor, count: int) -> tuple[int, int, int]:
    owners, sides, height, width, channels = images.shape
    return owners, sides * sum(rows * columns for rows, columns in level_sizes(height, width, count)), channels


@registration.operator
def halve_levels_backward(grad: Tensor, count: int, sides: int, height: int, width: int) -> Tensor:
    """Compute the gradient of `halve_levels` to its images."""
    owners, total, channels = grad.shape
    sizes = level_sizes(height, width, count)
    # On CUDA one launch reads all levels at each texel of the largest one; on the CPU a launch reads two.
    levels = [0] if concurrent(grad.device) else range(max(count - 2, 0), -1, -1)
    size = {"owners": owners, "sides": sides, "channels": channels, "height": height, "width": width}
    call = _HalveLevelsBackward(grad=grad, total=total, smaller=count - 1, **size)
    to_level = grad
    for level in levels:
        rows, columns = sizes[level]
        finer = empty((owners, sides, rows, columns, channels), grad.device)
        tasks, call.each = pixel_tasks(owners * sides * rows, columns, grad.device)
        call.level, call.to_level = level, finer.data_ptr()
        launch(_halve_levels_backward, tasks, [call], grad.device, worth_a_thread(call.each * columns))
        to_level = finer  # the next launch reads it
        call.smaller, call.known = level, call.to_level
    return to_level


@registration.fake(halve_levels_backward)
def _(grad: Tensor, sides: int, height: int, width: int) -> Tensor:
    return grad.new_empty((grad.shape[0], sides, height, width, grad.shape[2]))


def _save_size(ctx: Any, inputs: Any, output: Any) -> None:
    levels, count, *_ = inputs
    ctx.size = (count, *levels.shape[1:4])


registration.differentiable(
    halve_levels,
    lambda ctx, grad: {"images": halve_levels_backward(grad, *ctx.size)},
    _save_size,
    lambda inputs, tangents: halve_levels(tangents[0], inputs[1]),
)


# Both are linear: each is the other's transpose.
registration.differentiable(
    halve_levels_backward,
    lambda ctx, grad: {"grad": halve_levels(grad, ctx.size[0])},
    _save_size,
    lambda inputs, tangents: halve_levels_backward(tangents[0], *inputs[1:]),
)


@registration.operator
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
        footprint: Change of each coordinate by one pixel, right and up in turn, [B, H, W, 4 or 6] float32.
        bias: Added to the level, [B, H, W] float32.
        size: Height and width of the largest level, and number of levels.
        filter_mode: One of `FILTERS`.
        boundary: Those of `BOUNDARIES` along s and t; both are that of "cube", or neither.

    Returns:
        [B, H, W, C] float32; 0 for directions of length 0.
    """
    batch, height, width, _ = uv.shape
    result = empty((batch, height, width, texels.shape[2]), uv.device)
    tasks, each = pixel_tasks(batch * height, width, uv.device)
    fields = _fields(each, texels, uv, footprint, bias, size, filter_mode, boundary)
    call = _SampleLevels(**fields, result=result)
    launch(_sample_levels, tasks, [call], uv.device, worth_a_thread(each * width))
    return result


@registration.fake(sample_levels)
def _(texels: Tensor, uv: Tensor) -> Tensor:
    return uv.new_empty((*uv.shape[:3], texels.shape[2]))


@registration.gradient_of(sample_levels, "texels", "uv", "footprint", "bias", once=True)
def sample_levels_backward(grad: Tensor, texels_too: bool, *inputs: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the gradients to texels (empty if not ``texels_too``), uv, footprint and bias (empty if None)."""
    texels, uv, footprint, bias, *_ = inputs
    batch, height, width, _ = uv.shape
    device = uv.device
    to_texels = zeros(registration.gradient_shape(texels, texels_too), device)
    to_uv, to_footprint, to_bias = (empty(registration.gradient_shape(each), device) for each in (uv, footprint, bias))
    tasks, each = pixel_tasks(batch * height, width, device)
    if texels_too:
        tasks, each = owner_tasks(texels.shape[0], batch, height, width, device)
    call = _SampleLevelsBackward(
        **_fields(each, *inputs),
        grad=grad,
        texels_too=texels_too,
        to_texels=to_texels,
        to_uv=to_uv,
        to_footprint=None if footprint is None else to_footprint,
        to_bias=None if bias is None else to_bias,
    )
    launch(_sample_levels_backward, tasks, [call], device, worth_a_thread(each * width))
    return to_texels, to_uv, to_footprint, to_bias


def _fields(each: int, *inputs: Any) -> dict[str, Call]:
    """Make the `TextureLevels` and `Lookups` of kernels from `sample_levels`' inputs, for tasks of ``each`` rows."""
    texels, uv, footprint, bias, size, filter_mode, boundary = inputs
    texture = _TextureLevels(
        texels=texels,
        total=texels.shape[1],
        owners=texels.shape[0],
        channels=texels.shape[2],
        height=size[0],
        width=size[1],
        levels=size[2],
        filter=filter_mode,
        boundary=boundary[0],
        boundary_t=boundary[1],
    )
    images, height, width, _ = uv.shape
    size_of_images = {"images": images, "height": height, "width": width}
    return {"texture": texture, "at": _Lookups(uv=uv, footprint=footprint, bias=bias, each=each, **size_of_images)}


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    results = sample_levels_backward(grad, ctx.needs_input_grad[0], *registration.saved_inputs(ctx))
    return dict(zip(("texels", "uv", "footprint", "bias"), results, strict=True))


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    """Sum the tangents by each input. A pixel depends only on its own coordinates: one reverse pass per channel."""
    texels, *others = inputs
    parts = [] if tangents[0] is None else [sample_levels(tangents[0], *others)]
    if any(each is not None for each in tangents[1:4]):
        units = torch.eye(texels.shape[2], device=texels.device).expand(*inputs[1].shape[:3], -1, -1).unbind(3)
        rows = [sample_levels_backward(unit, False, *inputs)[1:] for unit in units]
        for tangent, slopes in zip(tangents[1:4], zip(*rows, strict=True), strict=True):
            if tangent is not None:
                slope = torch.stack(slopes, 3)  # [B, H, W, C], or [B, H, W, C, 2 to 6]
                if slope.dim() == 4:
                    parts.append(slope * tangent[..., None])
                else:
                    parts.append((slope * tangent[..., None, :]).sum(-1))
    return registration.sum_of(parts)


registration.differentiable(sample_levels, _to_inputs, registration.save_inputs, _forward)
