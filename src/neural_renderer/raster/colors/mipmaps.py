"""Texture sampling, trilinear between mipmaps (Williams, "Pyramidal parametrics", 1983)."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor
from torch.nn import functional

from ..warp.launch import array, launch
from ..warp.layout import PIXELS_OF_TASK, in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.point import fill
from ..warp.registration import differentiable, operator, refuse_second

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
    texels: Tensor,
    height: int,
    width: int,
    uv: Tensor,
    face_index: Tensor,
    mipmaps: bool,
    repeat_u: bool,
    repeat_v: bool,
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
        repeat_u: Whether the image repeats to the left and right of [0, 1]; else its border is extended.
        repeat_v: The same, below and above.

    Returns:
        [B, H, W, C] float32; 0 where ``face_index`` is negative.
    """
    batch, rows, columns = face_index.shape
    result = empty((batch, rows, columns, texels.shape[2]), texels.device)
    tasks, each = pixel_tasks(batch * rows, columns, texels.device)
    arguments = [*_arguments(texels, height, width, uv, face_index, mipmaps, repeat_u, repeat_v), each, array(result)]
    launch(_forward, tasks, arguments, texels.device, worth_a_thread(each * columns))
    return result


@torch.library.register_fake("neural_renderer::sample_mipmaps")
def _(texels, height, width, uv, face_index, mipmaps, repeat_u, repeat_v):
    return uv.new_empty((*face_index.shape, texels.shape[2]))


@operator
def sample_mipmaps_backward(
    grad: Tensor,
    texels: Tensor,
    height: int,
    width: int,
    uv: Tensor,
    face_index: Tensor,
    mipmaps: bool,
    repeat_u: bool,
    repeat_v: bool,
    texels_too: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `sample_mipmaps` to texels (empty if not ``texels_too``) and to uv.

    On the CPU, and if torch asks for deterministic results, one task sums the gradient to each image's texels; a batch
    that shares one image is one task. Otherwise the order of sums varies on CUDA.
    """
    batch, rows, columns = face_index.shape
    to_texels = zeros(texels.shape if texels_too else (0, 0, 0), texels.device)
    to_uv = zeros(uv.shape, uv.device)
    tasks, each = pixel_tasks(batch * rows, columns, texels.device)
    if texels_too and not in_any_order(texels.device):
        each = batch * rows // max(len(texels), 1)
        tasks = len(texels) if each else 0
    arguments = [*_arguments(texels, height, width, uv, face_index, mipmaps, repeat_u, repeat_v), each, array(grad)]
    arguments += [int(texels_too), array(to_texels), array(to_uv, wp.vec2)]
    launch(_backward, tasks, arguments, texels.device, worth_a_thread(each * columns))
    return to_texels, to_uv


@torch.library.register_fake("neural_renderer::sample_mipmaps_backward")
def _(grad, texels, height, width, uv, face_index, mipmaps, repeat_u, repeat_v, texels_too):
    return texels.new_empty(texels.shape if texels_too else (0, 0, 0)), uv.new_empty(uv.shape)


def _arguments(texels, height, width, uv, face_index, mipmaps, repeat_u, repeat_v):
    levels = max(height, width).bit_length() if mipmaps else 1
    return [array(texels), height, width, levels, array(uv, wp.vec2), array(face_index), int(repeat_u), int(repeat_v)]


def _save(ctx, inputs, output):
    texels, ctx.height, ctx.width, uv, face_index, ctx.mipmaps, ctx.repeat_u, ctx.repeat_v = inputs
    ctx.save_for_backward(texels, uv, face_index)


def _to_inputs(ctx, grad):
    texels, uv, face_index = ctx.saved_tensors
    texels_too, uv_too = ctx.needs_input_grad[0], ctx.needs_input_grad[3]
    to_texels, to_uv = sample_mipmaps_backward(
        grad, texels, ctx.height, ctx.width, uv, face_index, ctx.mipmaps, ctx.repeat_u, ctx.repeat_v, texels_too
    )
    return to_texels if texels_too else None, None, None, to_uv if uv_too else None, None, None, None, None


differentiable(sample_mipmaps, _to_inputs, _save)


def _save_again(ctx, inputs, output):
    _, _, *ctx.size, uv, face_index, mipmaps, repeat_u, repeat_v, ctx.texels_too = inputs
    ctx.options = (mipmaps, repeat_u, repeat_v)
    ctx.save_for_backward(uv, face_index)


def _to_gradient(ctx, texels, _):
    # The gradient to texels is the transpose of the sampling, so that its own gradient samples.
    if ctx.needs_input_grad[4]:
        refuse_second("sample_mipmaps_backward")
    to_grad = sample_mipmaps(texels, *ctx.size, *ctx.saved_tensors, *ctx.options) if ctx.texels_too else None
    return to_grad, *[None] * 9


differentiable(sample_mipmaps_backward, _to_gradient, _save_again)


# C++ structs: a texture with mipmaps; the texels of one level around a point, and their weights.
_TEXTURE = """
struct Texture {
    typedef wp::vec_t<2, float> vec2;
    int height, width, levels, repeat_u, repeat_v;

    // The change of uv to the next pixel, or from the previous one; 0 if neither shows the same face.
    static CUDA_CALLABLE vec2 change(const vec2* uv, const int* shown, bool next, bool previous, wp::int64 step) {
        if (next && shown[step] == shown[0]) return uv[step] - uv[0];
        if (previous && shown[-step] == shown[0]) return uv[0] - uv[-step];
        return vec2(0.0f, 0.0f);
    }
    // log2 of the texels along the longer side of the pixel i, clamped to the levels.
    CUDA_CALLABLE float level(const vec2* uv, const int* shown, int i, int j, int columns, int rows) const {
        if (levels == 1) return 0.0f;
        const vec2 x = change(uv, shown, i + 1 < columns, i > 0, 1);
        const vec2 y = change(uv, shown, j + 1 < rows, j > 0, columns);
        const float w = (float)width, h = (float)height;
        const float across = x[0] * x[0] * w * w + x[1] * x[1] * h * h;
        const float down = y[0] * y[0] * w * w + y[1] * y[1] * h * h;
        const float longest = across > down ? across : down;
        if (!(longest > 1.0f)) return 0.0f;
        const float chosen = 0.5f * log2f(longest), last = (float)(levels - 1);
        return chosen < last ? chosen : last;
    }

    struct Side {
        int texel[2];
        float part[2], slope;  // the slope of the position by the coordinate, in texels
        CUDA_CALLABLE Side(float at, int size, int repeat) {
            const float raw = at * (float)size - 0.5f, last = (float)(size - 1);
            float x = raw < last ? raw : last;
            x = x > 0.0f ? x : 0.0f;
            slope = repeat || (raw >= 0.0f && raw <= last) ? (float)size : 0.0f;
            if (repeat) x = (at - floorf(at)) * (float)size - 0.5f;
            const float low = floorf(x);
            part[1] = x - low, part[0] = 1.0f - part[1];
            for (int k = 0; k < 2; ++k) {
                int n = (int)low + k;
                if (repeat) n = n < 0 ? n + size : n >= size ? n - size : n;
                texel[k] = n < 0 ? 0 : n >= size ? size - 1 : n;  // for NaN coordinates, too
            }
        }
    };
    // One level around a point: the place of its first texel, and the sides.
    struct Level {
        wp::int64 first, width;
        Side x, y;
        CUDA_CALLABLE wp::int64 texel(int down, int right) const {
            return first + y.texel[down] * width + x.texel[right];
        }
    };
    CUDA_CALLABLE Level at(vec2 uv, int n) const {
        int wide = width, high = height;
        wp::int64 before = 0;
        for (int k = 0; k < n; ++k) {
            before += (wp::int64)wide * high;
            wide = wide > 1 ? wide >> 1 : 1, high = high > 1 ? high >> 1 : 1;
        }
        return {before, wide, Side(uv[0], wide, repeat_u), Side(1.0f - uv[1], high, repeat_v)};
    }
};
"""

# Over the pixels of a task, see `pixel_tasks`; PIXEL is done for the pixels that show a face, LEVEL for each
# of their levels, with its share.
_ROWS = (
    _TEXTURE
    + """
    const int rows = face_index.shape[1], columns = face_index.shape[2], channels = texels.shape[2];
    const Texture texture = {height, width, levels, repeat_u, repeat_v};
    const int all = face_index.shape[0] * rows;
    PIXELS_OF_TASK
    for (int line = first; line < last; ++line) {
        const int b = line / rows, j = line % rows;
        const wp::int64 own = b < texels.shape[0] ? b : texels.shape[0] - 1;
        const float* image = texels.data + own * texels.shape[1] * channels;
        for (int i = left; i < right; ++i) {
            const wp::int64 pixel = (wp::int64)line * columns + i;
            BEGIN
            if (face_index.data[pixel] < 0) continue;
            const wp::vec_t<2, float> at = uv.data[pixel];
            const float chosen = texture.level(uv.data + pixel, face_index.data + pixel, i, j, columns, rows);
            const int low = (int)chosen;
            for (int n = low; n < low + 2 && n < levels; ++n) {
                const float share = n == low ? 1.0f - (chosen - (float)low) : chosen - (float)low;
                if (!(share > 0.0f)) continue;
                const Texture::Level level = texture.at(at, n);
                if (channels == 3) { const int channels = 3; LEVEL }
                else { LEVEL }
            }
            END
        }
    }
"""
)

_TEXELS = """
                const float *x = level.x.part, *y = level.y.part;
                const float* __restrict__ above[2] = {image + level.texel(0, 0) * channels,
                                                      image + level.texel(0, 1) * channels};
                const float* __restrict__ below[2] = {image + level.texel(1, 0) * channels,
                                                      image + level.texel(1, 1) * channels};
"""
_BLEND = (
    _TEXELS
    + """
                const float up = share * y[0], down = share * y[1];
                for (int c = 0; c < channels; ++c)
                    color[c] += up * (x[0] * above[0][c] + x[1] * above[1][c])
                        + down * (x[0] * below[0][c] + x[1] * below[1][c]);
"""
)
_BLEND_ROWS = fill(
    _ROWS,
    PIXELS_OF_TASK=PIXELS_OF_TASK.replace("width", "columns"),
    BEGIN="""
            float* __restrict__ color = result.data + pixel * channels;
            for (int c = 0; c < channels; ++c) color[c] = 0.0f;
    """,
    LEVEL=_BLEND,
    END="",
)


@wp.func_native(_BLEND_ROWS)
def blend_rows(
    texels: wp.array3d(dtype=float),
    height: int,
    width: int,
    levels: int,
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    repeat_u: int,
    repeat_v: int,
    result: wp.array4d(dtype=float),
    task: int,
    each: int,
):
    """Sample the pixels of a task."""
    ...


@wp.kernel
def _forward(
    first: int,
    texels: wp.array3d(dtype=float),
    height: int,
    width: int,
    levels: int,
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    repeat_u: int,
    repeat_v: int,
    each: int,
    result: wp.array4d(dtype=float),
):
    blend_rows(texels, height, width, levels, uv, face_index, repeat_u, repeat_v, result, first + wp.tid(), each)


_SCATTER = (
    _TEXELS
    + """
                float gain[4] = {0.0f, 0.0f, 0.0f, 0.0f};  // gradient with respect to each texel's weight
                for (int c = 0; c < channels; ++c) {
                    const float g = share * pull[c];
                    gain[0] += g * above[0][c], gain[1] += g * above[1][c];
                    gain[2] += g * below[0][c], gain[3] += g * below[1][c];
                    if (!texels_too) continue;
                    float* to = to_image + c;
                    ADD(to + (above[0] - image), g * y[0] * x[0]);
                    ADD(to + (above[1] - image), g * y[0] * x[1]);
                    ADD(to + (below[0] - image), g * y[1] * x[0]);
                    ADD(to + (below[1] - image), g * y[1] * x[1]);
                }
                to_x += (y[0] * (gain[1] - gain[0]) + y[1] * (gain[3] - gain[2])) * level.x.slope;
                to_y += (x[0] * (gain[2] - gain[0]) + x[1] * (gain[3] - gain[1])) * level.y.slope;
"""
)
_SCATTER_ROWS = """
    #if defined(__CUDA_ARCH__)
    #define ADD(to, value) wp::atomic_add(to, value)
    #else
    #define ADD(to, value) *(to) += value  // one task writes an image's texels
    #endif
""" + fill(
    _ROWS,
    PIXELS_OF_TASK=PIXELS_OF_TASK.replace("width", "columns"),
    BEGIN="""
            const float* pull = grad.data + pixel * channels;
            float* to_image = to_texels.data + own * texels.shape[1] * channels;
            float to_x = 0.0f, to_y = 0.0f;
    """,
    LEVEL=_SCATTER,
    END="to_uv.data[pixel] = wp::vec_t<2, float>(to_x, -to_y);",
)


@wp.func_native(_SCATTER_ROWS)
def scatter_rows(
    texels: wp.array3d(dtype=float),
    height: int,
    width: int,
    levels: int,
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    repeat_u: int,
    repeat_v: int,
    grad: wp.array4d(dtype=float),
    texels_too: int,
    to_texels: wp.array3d(dtype=float),
    to_uv: wp.array3d(dtype=wp.vec2),
    task: int,
    each: int,
):
    """Send the gradients of the pixels of a task."""
    ...


@wp.kernel
def _backward(
    first: int,
    texels: wp.array3d(dtype=float),
    height: int,
    width: int,
    levels: int,
    uv: wp.array3d(dtype=wp.vec2),
    face_index: wp.array3d(dtype=int),
    repeat_u: int,
    repeat_v: int,
    each: int,
    grad: wp.array4d(dtype=float),
    texels_too: int,
    to_texels: wp.array3d(dtype=float),
    to_uv: wp.array3d(dtype=wp.vec2),
):
    task = first + wp.tid()
    scatter_rows(
        texels,
        height,
        width,
        levels,
        uv,
        face_index,
        repeat_u,
        repeat_v,
        grad,
        texels_too,
        to_texels,
        to_uv,
        task,
        each,
    )
