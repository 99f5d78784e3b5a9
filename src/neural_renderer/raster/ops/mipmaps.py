"""Texture sampling, trilinear between mipmaps (Williams, "Pyramidal parametrics", 1983)."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor
from torch.nn import functional

from ..warp.launch import array, concurrent, launch, worth_a_thread, zeros
from ..warp.registration import differentiable, differentiable_once, operator

wp.set_module_options({"enable_backward": False})


def pyramid(image: Tensor) -> Tensor:
    """Append the mipmaps of an image [N, C, h, w], each the mean at half the size, in one list of texels [N, T, C]."""
    levels = [image]
    while max(image.shape[2:]) > 1:
        half = (max(1, image.shape[2] // 2), max(1, image.shape[3] // 2))
        even = image.shape[2] == 2 * half[0] and image.shape[3] == 2 * half[1]
        # For even sides the adaptive mean is equal, but much slower.
        image = functional.avg_pool2d(image, 2) if even else functional.adaptive_avg_pool2d(image, half)
        levels.append(image)
    return torch.cat([level.flatten(2).transpose(1, 2) for level in levels], 1)


def level_sizes(height: int, width: int) -> list[tuple[int, int, int]]:
    """List (texels before it, height, width) of each level of `pyramid`."""
    sizes, before = [(0, height, width)], 0
    while max(height, width) > 1:
        before += height * width
        height, width = max(1, height // 2), max(1, width // 2)
        sizes.append((before, height, width))
    return sizes


@operator
def sample_mipmaps(
    texels: Tensor, height: int, width: int, uv: Tensor, face_index: Tensor, mipmaps: bool, repeat: bool
) -> Tensor:
    """Sample textures at texture coordinates; differentiable in texels and uv. Level selection is not differentiated.

    Args:
        texels: As from `pyramid`, [B or 1, T, C] float32.
        height: Height of the image.
        width: Width of the image.
        uv: Texture coordinates, [B, H, W, 2] float32; u to the right, v up, the image over [0, 1]². Texel centres have
            the colours of the texels.
        face_index: Visible face of each pixel, [B, H, W] int32.
        mipmaps: Whether to average over the change of uv to the next pixel of the same face, or from the previous one
            if there is none; else the image itself is sampled.
        repeat: Whether the image repeats outside [0, 1]; else its border is extended.

    Returns:
        [B, H, W, C] float32; 0 where ``face_index`` is negative.
    """
    batch, rows, columns = face_index.shape
    result = torch.empty((batch, rows, columns, texels.shape[2]), dtype=torch.float32, device=texels.device)
    arguments = _arguments(texels, height, width, uv, face_index, mipmaps, repeat)
    launch(_forward, batch * rows, [*arguments, array(result)], texels.device, worth_a_thread(columns))
    return result


@torch.library.register_fake("neural_renderer::sample_mipmaps")
def _(texels, height, width, uv, face_index, mipmaps, repeat):  # type: ignore[no-untyped-def]
    return uv.new_empty((*face_index.shape, texels.shape[2]))


@differentiable_once
def sample_mipmaps_backward(
    grad: Tensor,
    texels: Tensor,
    height: int,
    width: int,
    uv: Tensor,
    face_index: Tensor,
    mipmaps: bool,
    repeat: bool,
    texels_too: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `sample_mipmaps` to texels (empty if not ``texels_too``) and to uv.

    On the CPU one task sums the gradient to each image's texels, without atomics; a batch that shares one image is one
    task. On CUDA the order of sums varies.

    Raises:
        RuntimeError: On CUDA, if torch asks for deterministic results.
    """
    batch, rows, _ = face_index.shape
    to_texels = zeros(texels.shape if texels_too else (0, 0, 0), texels.device)
    to_uv = zeros(uv.shape, uv.device)
    if texels_too and concurrent(texels.device) and torch.are_deterministic_algorithms_enabled():
        raise RuntimeError("sample_texture: no deterministic gradient to a texture on CUDA, got a request for one")
    tasks = len(texels) if texels_too and not concurrent(texels.device) else batch * rows
    arguments = _arguments(texels, height, width, uv, face_index, mipmaps, repeat)
    pixels = [batch * rows // tasks if tasks else 0, int(texels_too)]
    launch(_backward, tasks, [*arguments, array(grad), *pixels, array(to_texels), array(to_uv, wp.vec2)], texels.device)
    return to_texels, to_uv


@torch.library.register_fake("neural_renderer::sample_mipmaps_backward")
def _(grad, texels, height, width, uv, face_index, mipmaps, repeat, texels_too):  # type: ignore[no-untyped-def]
    return texels.new_empty(texels.shape if texels_too else (0, 0, 0)), uv.new_empty(uv.shape)


def _arguments(texels, height, width, uv, face_index, mipmaps, repeat):  # type: ignore[no-untyped-def]
    sizes = torch.tensor(level_sizes(height, width), dtype=torch.int32)
    if texels.is_cuda:
        sizes = sizes.pin_memory().to(texels.device, non_blocking=True)
    maps = [array(uv, wp.vec2), array(face_index)]
    return [array(texels), array(sizes, wp.vec3i), *maps, int(mipmaps), int(repeat)]


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    texels, ctx.height, ctx.width, uv, face_index, ctx.mipmaps, ctx.repeat = inputs
    ctx.save_for_backward(texels, uv, face_index)


def _to_inputs(ctx, grad):  # type: ignore[no-untyped-def]
    texels, uv, face_index = ctx.saved_tensors
    texels_too, uv_too = ctx.needs_input_grad[0], ctx.needs_input_grad[3]
    to_texels, to_uv = sample_mipmaps_backward(
        grad, texels, ctx.height, ctx.width, uv, face_index, ctx.mipmaps, ctx.repeat, texels_too
    )
    return to_texels if texels_too else None, None, None, to_uv if uv_too else None, None, None, None


differentiable(sample_mipmaps, _to_inputs, _save)


@wp.func
def change(
    uv: wp.array3d(dtype=wp.vec2), face_index: wp.array3d(dtype=int), b: int, j: int, i: int, down: int, right: int
) -> wp.vec2:
    """Compute the change of uv to the next pixel, or from the previous one; 0 if neither shows the same face."""
    f = face_index[b, j, i]
    at = uv[b, j, i]
    if j + down < face_index.shape[1] and i + right < face_index.shape[2]:
        if face_index[b, j + down, i + right] == f:
            return uv[b, j + down, i + right] - at
    if j - down >= 0 and i - right >= 0:
        if face_index[b, j - down, i - right] == f:
            return at - uv[b, j - down, i - right]
    return wp.vec2(0.0, 0.0)


@wp.func
def level_of(
    sizes: wp.array1d(dtype=wp.vec3i),
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    b: int,
    j: int,
    i: int,
) -> float:
    """Select the mipmap level: log2 of the texels along the longer side of a pixel, clamped to the levels."""
    size = wp.vec2(float(sizes[0][2]), float(sizes[0][1]))
    x = wp.cw_mul(change(uv, face_index, b, j, i, 0, 1), size)
    y = wp.cw_mul(change(uv, face_index, b, j, i, 1, 0), size)
    longest = wp.max(wp.dot(x, x), wp.dot(y, y))
    if longest > 1.0:
        return wp.min(0.5 * wp.log2(longest), float(sizes.shape[0] - 1))
    return 0.0


@wp.func
def column(x: int, width: int, repeat: int) -> int:
    """Wrap or clamp a position in a row or column, at most one texel outside."""
    if repeat == 1:
        if x < 0:
            x += width
        if x >= width:
            x -= width
    return wp.clamp(x, 0, width - 1)  # for NaN coordinates, too


@wp.func
def texel_place(at: float, size: int, repeat: int) -> float:
    """Convert a texture coordinate to texels, whose centres are the integers."""
    if repeat == 1:
        return (at - wp.floor(at)) * float(size) - 0.5
    return wp.clamp(at * float(size) - 0.5, 0.0, float(size - 1))


@wp.func
def slope_of(at: float, size: int, repeat: int) -> float:
    """Compute the derivative of `texel_place` by the coordinate."""
    x = at * float(size) - 0.5
    if repeat == 0 and (x < 0.0 or x > float(size - 1)):
        return 0.0
    return float(size)


@wp.func
def texel_of(at: wp.vec2, size: wp.vec3i, repeat: int, corner: int):
    """Find one of the four texels of a level around uv, and its bilinear weights along columns and rows."""
    x = texel_place(at[0], size[2], repeat)
    y = texel_place(1.0 - at[1], size[1], repeat)
    left = int(wp.floor(x)) + corner % 2
    top = int(wp.floor(y)) + corner // 2
    texel = size[0] + column(top, size[1], repeat) * size[2] + column(left, size[2], repeat)
    return texel, 1.0 - wp.abs(x - float(left)), 1.0 - wp.abs(y - float(top))


@wp.kernel
def _forward(
    first: int,
    texels: wp.array3d(dtype=float),
    sizes: wp.array1d(dtype=wp.vec3i),
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    mipmaps: int,
    repeat: int,
    result: wp.array4d(dtype=float),
):
    """Sample one row of one image."""
    task = first + wp.tid()
    b = task // face_index.shape[1]
    j = task % face_index.shape[1]
    own = wp.min(b, texels.shape[0] - 1)
    channels = texels.shape[2]
    for i in range(face_index.shape[2]):
        for c in range(channels):
            result[b, j, i, c] = 0.0
        if face_index[b, j, i] >= 0:
            level = float(0.0)
            if mipmaps == 1:
                level = level_of(sizes, uv, face_index, b, j, i)
            at = uv[b, j, i]
            for n in range(int(level), wp.min(int(level) + 2, sizes.shape[0])):
                share = 1.0 - wp.abs(level - float(n))
                if share > 0.0:
                    for corner in range(4):
                        texel, across, along = texel_of(at, sizes[n], repeat, corner)
                        part = share * across * along
                        for c in range(channels):
                            result[b, j, i, c] += part * texels[own, texel, c]


@wp.kernel
def _backward(
    first: int,
    texels: wp.array3d(dtype=float),
    sizes: wp.array1d(dtype=wp.vec3i),
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    mipmaps: int,
    repeat: int,
    grad: wp.array4d(dtype=float),
    rows: int,
    texels_too: int,
    to_texels: wp.array3d(dtype=float),
    to_uv: wp.array3d(dtype=wp.vec2),
):
    """Send the gradients of ``rows`` rows, counted over all images."""
    task = first + wp.tid()
    channels = texels.shape[2]
    for line in range(task * rows, (task + 1) * rows):
        b = line // face_index.shape[1]
        j = line % face_index.shape[1]
        own = wp.min(b, texels.shape[0] - 1)
        for i in range(face_index.shape[2]):
            if face_index[b, j, i] >= 0:
                level = float(0.0)
                if mipmaps == 1:
                    level = level_of(sizes, uv, face_index, b, j, i)
                at = uv[b, j, i]
                to_x = float(0.0)
                to_y = float(0.0)
                for n in range(int(level), wp.min(int(level) + 2, sizes.shape[0])):
                    share = 1.0 - wp.abs(level - float(n))
                    if share > 0.0:
                        size = sizes[n]
                        for corner in range(4):
                            texel, across, along = texel_of(at, size, repeat, corner)
                            gain = float(0.0)
                            for c in range(channels):
                                pull = share * grad[b, j, i, c]
                                gain += pull * texels[own, texel, c]
                                if texels_too == 1:
                                    wp.atomic_add(to_texels, own, texel, c, pull * across * along)
                            right = float(2 * (corner % 2) - 1)
                            down = float(2 * (corner // 2) - 1)
                            to_x += gain * along * right * slope_of(at[0], size[2], repeat)
                            to_y += gain * across * down * slope_of(1.0 - at[1], size[1], repeat)
                to_uv[b, j, i] = wp.vec2(to_x, -to_y)
