"""Texture sampling, trilinear between mipmaps (Williams, "Pyramidal parametrics", 1983)."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

import functools
import math
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.weak import WeakTensorKeyDictionary

from ...base import private
from ..warp import registration
from ..warp.elementwise import FEW, are_for_numpy, equal, joined, linear
from ..warp.launch import launch
from ..warp.layout import in_any_order, pixel_tasks, readable, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Kernels

_KERNELS = Kernels(__name__, "mipmaps.h")
_Mipmaps, _Samples = _KERNELS.struct("Mipmaps"), _KERNELS.struct("Samples")
_SampleMipmaps, _SampleMipmapsBackward = _KERNELS.struct("SampleMipmaps"), _KERNELS.struct("SampleMipmapsBackward")
_FORWARD = Kernels(__name__ + ".forward", "mipmaps.h")
_SampleMipmapsForward = _FORWARD.struct("SampleMipmapsForward")
_sample_mipmaps = _KERNELS.kernel("sample_mipmaps", _SampleMipmaps)
_sample_mipmaps_backward = _KERNELS.kernel("sample_mipmaps_backward", _SampleMipmapsBackward)
_sample_mipmaps_forward = _FORWARD.kernel("sample_mipmaps_forward", _SampleMipmapsForward)


_MOST = 1 << 28  # bytes of the largest cached pyramid
_SEVERAL = 64  # most cached pyramids of parts of one tensor
_cache = WeakTensorKeyDictionary()  # by tensor: the version and pyramid of each part
_lock = threading.Lock()


def all_levels(height: int, width: int) -> int:
    """Count the levels of an image, down to one texel."""
    return max(height, width).bit_length()


def pyramid(image: Tensor, count: int) -> Tensor:
    """Concatenate an image [N, C, h, w] and its mipmaps, each averaged to half the size, to texels [N, T, C]."""
    levels = [image]
    while len(levels) < count:
        image = halved(image)
        levels.append(image)
    return joined([level.flatten(2).transpose(1, 2) for level in levels], 1)


def halved(image: Tensor) -> Tensor:
    """Average an image [N, C, h, w] to half the size, rounded down, at least 1; an odd side by three texels each.

    Unlike adaptive pooling, which gives the same, it is deterministic on CUDA, and strides change no bit there.
    """
    sides = [2 + side % 2 if side > 1 else 1 for side in image.shape[2:]]
    if image.dtype != torch.float32 or not are_for_numpy(image):
        return functional.avg_pool2d(image, sides, 2)
    if image.numel() <= FEW and torch.get_num_threads() == 1:
        return functional.avg_pool2d(image, sides, 2)  # which takes less time
    places, share = [*np.ndindex(*sides)], np.float32(math.prod(sides))

    def texels(values: np.ndarray, place: tuple[int, ...]) -> np.ndarray:  # a view of one of each block
        (row, column), (height, width) = place, image.shape[2:]
        return values[..., row : height - sides[0] + row + 1 : 2, column : width - sides[1] + column + 1 : 2]

    def mean(values: np.ndarray) -> np.ndarray:
        total = functools.reduce(np.add, (texels(values, place) for place in places))
        return np.divide(total, share, out=total if len(places) > 1 else None)

    def spread(grad: np.ndarray) -> np.ndarray:
        part = grad / share
        if 3 not in sides:  # blocks do not overlap
            result = np.empty(image.shape, np.float32)
            for place in places:
                texels(result, place)[...] = part
            return result
        result = np.zeros(image.shape, np.float32)
        for place in reversed(places):
            texels(result, place)[...] += part
        return result

    # torch's pooling, to the bit, but that takes threads for the smallest images.
    return linear(image, mean, spread)


def cached_pyramid(image: Tensor, count: int) -> Tensor:
    """Return the `pyramid` of images [N, h, w, C] float32, cached for the lifetime of an image without a gradient.

    On the CPU the cached pyramid is compared with the image. On CUDA comparing values would synchronise, so it is valid
    until torch counts an in-place change of the tensor.
    """
    texels = 4 * image.numel() // 3
    known = registration.of_constants(lambda own: _find_pyramid(own, count), image) if 0 < 4 * texels <= _MOST else None
    return pyramid(image.permute(0, 3, 1, 2), count) if known is None else known


def _find_pyramid(image: Tensor, count: int) -> Tensor | None:
    base = private.base_of(image)
    version = private.version_of(base)
    if version is None and not readable(image.device):
        return None
    place = (image.storage_offset(), image.shape, image.stride(), count)
    with _lock:
        known = _cache.get(base, {}).get(place)
    if known is not None:
        first = known[1][:, : image.shape[1] * image.shape[2]]
        if equal(first, image.flatten(1, 2)) if readable(image.device) else known[0] == version:
            return known[1]
    with torch.inference_mode(False), torch.no_grad():  # cached values may be needed with gradients later
        made = pyramid(image.clone().permute(0, 3, 1, 2), count)
    with _lock:
        several = _cache.setdefault(base, {})
        if len(several) >= _SEVERAL and place not in several:
            several.clear()
        several[place] = (version, made)
    return made


def level_sizes(height: int, width: int) -> list[tuple[int, int, int]]:
    """List (texels before it, height, width) of each level of `pyramid`."""
    sizes, before = [(0, height, width)], 0
    while max(height, width) > 1:
        before += height * width
        height, width = max(1, height // 2), max(1, width // 2)
        sizes.append((before, height, width))
    return sizes


@registration.operator
def sample_mipmaps(
    texels: Tensor, height: int, width: int, uv: Tensor, face_index: Tensor, levels: int, repeat_u: bool, repeat_v: bool
) -> Tensor:
    """Sample textures at texture coordinates; differentiable in texels and uv. Level selection is not differentiated.

    Args:
        texels: As from `pyramid` of an image of this height and width, [B or 1, T, C] float32.
        uv: Texture coordinates, [B, H, W, 2] float32; u to the right, v up, the image over [0, 1]². Texel centres have
            the colours of the texels.
        levels: With more than one, the texture is averaged over the change of uv to the next pixel of the same face, or
            else from the previous one. With 1 the image itself is sampled.
        repeat_u, repeat_v: Whether the image repeats beyond [0, 1]; else its border is extended.

    Returns:
        [B, H, W, C] float32; 0 where ``face_index`` [B, H, W] int32 is negative.
    """
    batch, rows, columns = face_index.shape
    result = empty((batch, rows, columns, texels.shape[2]), texels.device)
    tasks, each = pixel_tasks(batch * rows, columns, texels.device)
    fields = _fields(each, texels, height, width, uv, face_index, levels, repeat_u, repeat_v)
    call = _SampleMipmaps(**fields, result=result)
    launch(_sample_mipmaps, tasks, [call], texels.device, worth_a_thread(each * columns))
    return result


@registration.fake(sample_mipmaps)
def _(texels: Tensor, uv: Tensor, face_index: Tensor) -> Tensor:
    return uv.new_empty((*face_index.shape, texels.shape[2]))


@registration.gradient_of(sample_mipmaps, "texels", "uv")
def sample_mipmaps_backward(grad: Tensor, texels_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `sample_mipmaps` to texels (empty if not ``texels_too``) and to uv.

    On the CPU, and if torch requires deterministic results, one task sums the gradient to the texels of each image; a
    batch with one shared image is one task. Otherwise the order of sums varies on CUDA.
    """
    texels, _, _, uv, face_index, *_ = inputs
    batch, rows, columns = face_index.shape
    to_texels = zeros(registration.gradient_shape(texels, texels_too), texels.device)
    to_uv = empty(uv.shape, uv.device)
    tasks, each = pixel_tasks(batch * rows, columns, texels.device)
    if texels_too and not in_any_order(texels.device):
        each = batch * rows // max(len(texels), 1)
        tasks = len(texels) if each else 0
    call = _SampleMipmapsBackward(
        **_fields(each, *inputs), grad=grad, texels_too=texels_too, to_texels=to_texels, to_uv=to_uv
    )
    launch(_sample_mipmaps_backward, tasks, [call], texels.device, worth_a_thread(each * columns))
    return to_texels, to_uv


@registration.forward_operator(1, sample_mipmaps)
def sample_mipmaps_forward(motion: Tensor, *inputs: Any) -> Tensor:
    """Compute the tangent [T, B, H, W, C] of `sample_mipmaps` for tangents of uv, [T, B, H, W, 2] float32."""
    texels, face_index = inputs[0], inputs[4]
    batch, rows, columns = face_index.shape
    change = empty((len(motion), batch, rows, columns, texels.shape[2]), texels.device)
    tasks, each = pixel_tasks(batch * rows, columns, texels.device)
    call = _SampleMipmapsForward(**_fields(each, *inputs), motion=motion, directions=len(motion), change=change)
    launch(_sample_mipmaps_forward, tasks, [call], texels.device, worth_a_thread(each * columns * len(motion)))
    return change


def _fields(each: int, *inputs: Any) -> dict[str, Any]:
    """Make the `Mipmaps` and `Samples` of kernels from the inputs of `sample_mipmaps`, for tasks of ``each`` rows."""
    texels, height, width, uv, face_index, levels, repeat_u, repeat_v = inputs
    maps = _Mipmaps(
        texels=texels,
        total=texels.shape[1],
        owners=len(texels),
        channels=texels.shape[2],
        height=height,
        width=width,
        levels=levels,
        repeat_u=repeat_u,
        repeat_v=repeat_v,
    )
    images, rows, columns = face_index.shape
    samples = _Samples(uv=uv, face_index=face_index, images=images, height=rows, width=columns, each=each)
    return {"maps": maps, "samples": samples}


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    to_texels, to_uv = sample_mipmaps_backward(grad, ctx.needs_input_grad[0], *registration.saved_inputs(ctx))
    return {"texels": to_texels, "uv": to_uv}


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    texels, *others = inputs
    parts = []
    if tangents[0] is not None:
        parts.append(sample_mipmaps(tangents[0], *others))
    if tangents[3] is not None:
        parts.append(registration.in_direction(sample_mipmaps_forward, tangents[3:4], texels, *others))
    return registration.sum_of(parts)


registration.differentiable(sample_mipmaps, _to_inputs, registration.save_inputs, _forward)


def _to_gradient(ctx: Any, texels: Tensor, _: Tensor) -> Any:
    # The gradient to texels is the transpose of sampling, so its own gradient samples.
    _, texels_too, _, *others = registration.saved_inputs(ctx)
    if ctx.needs_input_grad[5]:
        registration.refuse_second("sample_mipmaps_backward")
    return {"grad": sample_mipmaps(texels, *others) if texels_too else None}


registration.differentiable(sample_mipmaps_backward, _to_gradient, registration.save_inputs)
