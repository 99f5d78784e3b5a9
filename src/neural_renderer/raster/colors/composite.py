"""Compositing: the colours of visible faces over a background."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.layout import PIXELS_OF_TASK, pixel_tasks, worth_a_thread
from ..warp.memory import empty
from ..warp.point import VECTORS, fill
from ..warp.registration import differentiable, operator

wp.set_module_options({"enable_backward": False})


@operator
def composite(colors: Tensor, background: Tensor, face_index: Tensor) -> Tensor:
    """Put colours over a background; differentiable in both.

    Args:
        colors: [B, H, W, C] float32.
        background: [1 or B, C, 1 or H, 1 or W] float32.
        face_index: Visible face of each pixel, [B, H, W] int32; the background shows where it is -1.

    Returns:
        [B, C, H, W] float32.
    """
    batch, height, width = face_index.shape
    image = empty((batch, colors.shape[3], height, width), colors.device)
    behind = array(background.expand(image.shape), strided=True)
    tasks, each = pixel_tasks(batch * height, width, colors.device)
    arguments = [array(colors), behind, array(face_index), array(image), each]
    launch(_forward, tasks, arguments, colors.device, worth_a_thread(each * width))
    return image


@torch.library.register_fake("neural_renderer::composite")
def _(colors, background, face_index):
    batch, height, width = face_index.shape
    return colors.new_empty((batch, colors.shape[3], height, width))


@operator
def composite_backward(grad: Tensor, face_index: Tensor) -> Tensor:
    """Compute the gradient of `composite` to the colours, [B, H, W, C] float32."""
    batch, channels, height, width = grad.shape
    to_colors = empty((batch, height, width, channels), grad.device)
    tasks, each = pixel_tasks(batch * height, width, grad.device)
    arguments = [array(grad), array(face_index), array(to_colors), each]
    launch(_backward, tasks, arguments, grad.device, worth_a_thread(each * width))
    return to_colors


@torch.library.register_fake("neural_renderer::composite_backward")
def _(grad, face_index):
    batch, channels, height, width = grad.shape
    return grad.new_empty((batch, height, width, channels))


def _save(ctx, inputs, output):
    _, background, face_index = inputs
    ctx.behind = background.shape
    ctx.save_for_backward(face_index)


def _to_inputs(ctx, grad):
    face_index = ctx.saved_tensors[0]
    to_colors = composite_backward(grad, face_index) if ctx.needs_input_grad[0] else None
    to_background = None
    if ctx.needs_input_grad[1]:
        to_background = (grad * (face_index < 0)[:, None]).sum_to_size(ctx.behind)
    return to_colors, to_background, None


differentiable(composite, _to_inputs, _save)


def _save_again(ctx, inputs, output):
    ctx.save_for_backward(inputs[1])


def _to_gradient(ctx, colors):
    return composite(colors, colors.new_zeros((1, colors.shape[3], 1, 1)), ctx.saved_tensors[0]), None


differentiable(composite_backward, _to_gradient, _save_again)


# Three channels, the usual number, have a separate loop, because compilers turn it into vector instructions.
_PIXELS = """
    const int channels = image.shape[1], height = image.shape[2], width = image.shape[3], all = image.shape[0] * height;
    const wp::int64 area = (wp::int64)height * width;
    PIXELS_OF_TASK
    for (int row = first; row < last; ++row) {
        const int b = row / height, j = row % height;
        const int* __restrict__ shown = face_index.data + (wp::int64)row * width;
        float* __restrict__ plane = image.data + b * channels * area + (wp::int64)j * width;
        auto* __restrict__ color = colors.data + (wp::int64)row * width * channels;
        if (channels == 3) {
            float *__restrict__ red = plane, *__restrict__ green = plane + area, *__restrict__ blue = plane + 2 * area;
            THREE
            continue;
        }
        for (int c = 0; c < channels; ++c, plane += area) {
            EACH
        }
    }
"""
# Strides of the background are in bytes, and 0 along expanded axes.
_FORWARD = {
    "THREE": """
        const char *behind = (const char*)background.data + b * (wp::int64)background.strides[0]
            + j * (wp::int64)background.strides[2];
        const wp::int64 next = background.strides[1], step = background.strides[3];
        const auto at = [&](int c, int i) { return *(const float*)(behind + c * next + i * step); };
        if (step == 0) {
            const float r = at(0, 0), g = at(1, 0), b = at(2, 0);
            int i = left;
            #if !defined(__CUDA_ARCH__)
            for (; i + 8 <= right; i += 8) {
                Vectors::floats own[3];
                Vectors::ints here;
                Vectors::load(color + 3 * i, own), memcpy(&here, shown + i, sizeof(here));
                own[0] = here < 0 ? r : own[0], own[1] = here < 0 ? g : own[1], own[2] = here < 0 ? b : own[2];
                memcpy(red + i, &own[0], 32), memcpy(green + i, &own[1], 32), memcpy(blue + i, &own[2], 32);
            }
            #endif
            for (; i < right; ++i) {
                red[i] = shown[i] < 0 ? r : color[3 * i];
                green[i] = shown[i] < 0 ? g : color[3 * i + 1];
                blue[i] = shown[i] < 0 ? b : color[3 * i + 2];
            }
        } else {
            for (int i = left; i < right; ++i) {
                red[i] = shown[i] < 0 ? at(0, i) : color[3 * i];
                green[i] = shown[i] < 0 ? at(1, i) : color[3 * i + 1];
                blue[i] = shown[i] < 0 ? at(2, i) : color[3 * i + 2];
            }
        }
    """,
    "EACH": """
        const char* behind = (const char*)background.data + b * (wp::int64)background.strides[0]
            + c * (wp::int64)background.strides[1] + j * (wp::int64)background.strides[2];
        for (int i = left; i < right; ++i)
            plane[i] = shown[i] < 0 ? *(const float*)(behind + i * (wp::int64)background.strides[3])
                                    : color[(wp::int64)i * channels + c];
    """,
}
_BACKWARD = {
    "THREE": """
        int i = left;
        #if !defined(__CUDA_ARCH__)
        for (; i + 8 <= right; i += 8) {
            Vectors::floats own[3];
            Vectors::ints here;
            memcpy(&own[0], red + i, 32), memcpy(&own[1], green + i, 32), memcpy(&own[2], blue + i, 32);
            memcpy(&here, shown + i, sizeof(here));
            for (int k = 0; k < 3; ++k) own[k] = here < 0 ? Vectors::none() : own[k];
            Vectors::store(color + 3 * i, own[0], own[1], own[2]);
        }
        #endif
        for (; i < right; ++i) {
            color[3 * i] = shown[i] < 0 ? 0.0f : red[i];
            color[3 * i + 1] = shown[i] < 0 ? 0.0f : green[i];
            color[3 * i + 2] = shown[i] < 0 ? 0.0f : blue[i];
        }
    """,
    "EACH": "for (int i = left; i < right; ++i) color[(wp::int64)i * channels + c] = shown[i] < 0 ? 0.0f : plane[i];",
}


@wp.func_native(VECTORS + fill(_PIXELS, PIXELS_OF_TASK=PIXELS_OF_TASK, **_FORWARD))
def compose(
    colors: wp.array4d(dtype=float),
    background: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    image: wp.array4d(dtype=float),
    task: int,
    each: int,
):
    """Composite the pixels of a task."""
    ...


@wp.func_native(VECTORS + fill(_PIXELS, PIXELS_OF_TASK=PIXELS_OF_TASK, **_BACKWARD))
def part(
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    colors: wp.array4d(dtype=float),
    task: int,
    each: int,
):
    """Compute the pixels of a task of the gradient to the colours: the transpose of `compose`."""
    ...


@wp.kernel
def _forward(
    first: int,
    colors: wp.array4d(dtype=float),
    background: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    image: wp.array4d(dtype=float),
    each: int,
):
    compose(colors, background, face_index, image, first + wp.tid(), each)


@wp.kernel
def _backward(
    first: int,
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    to_colors: wp.array4d(dtype=float),
    each: int,
):
    part(grad, face_index, to_colors, first + wp.tid(), each)
