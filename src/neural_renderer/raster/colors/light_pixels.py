"""Light on an image: the colour of each pixel times the light on the visible side of its face."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import FACING
from ..warp.launch import array, launch
from ..warp.layout import PIXELS_OF_TASK, in_any_order, pixel_tasks, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.point import fill
from ..warp.registration import differentiable, operator

wp.set_module_options({"enable_backward": False})


@operator
def light_pixels(image: Tensor, light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> Tensor:
    """Multiply an image by the light on faces; differentiable in both.

    Args:
        image: [B, 3, H, W] float32.
        light: Factors on the front and the back of each face, [1 or B, 2, F, 3] float32. On the front, corners run
            counter-clockwise on the screen.
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32; where it is -1, the image stays as it is.
        perspective: As in `coverage`.

    Returns:
        [B, 3, H, W] float32.
    """
    batch, height, width = face_index.shape
    lit = empty(image.shape, image.device)
    arguments = [array(image), array(light, wp.vec3), array(faces, wp.vec3), array(face_index), int(perspective)]
    tasks, each = pixel_tasks(batch * height, width, image.device)
    launch(_forward, tasks, [*arguments, each, array(lit)], image.device, worth_a_thread(each * width))
    return lit


@torch.library.register_fake("neural_renderer::light_pixels")
def _(image, light, faces, face_index, perspective):
    return torch.empty_like(image, memory_format=torch.contiguous_format)


@operator
def light_pixels_backward(
    grad: Tensor, image: Tensor, light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `light_pixels` to the image, and to the light, [1 or B, 2, F, 3] float32."""
    batch, height, width = face_index.shape
    count = light.shape[2]
    to_image = empty(grad.shape, grad.device)
    to_light = zeros((batch, 2, count, 3), grad.device)
    arguments = [array(image), array(light, wp.vec3), array(faces, wp.vec3), array(face_index), int(perspective)]
    # On the CPU, and where the order of sums must not vary, one task takes all rows of an image: a run of 0.
    tasks, run = run_tasks(batch * height, width) if in_any_order(grad.device) else (batch, 0)
    arguments += [array(grad), run, array(to_image), array(to_light, wp.vec3)]
    launch(_backward, tasks, arguments, grad.device, worth_a_thread(height * width))
    return to_image, to_light.sum(0, keepdim=True) if light.shape[0] < batch else to_light


@torch.library.register_fake("neural_renderer::light_pixels_backward")
def _(grad, image, light, faces, face_index, perspective):
    return torch.empty_like(grad, memory_format=torch.contiguous_format), torch.empty_like(light)


def _save(ctx, inputs, output):
    *tensors, ctx.perspective = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx, grad):
    to_image, to_light = light_pixels_backward(grad, *ctx.saved_tensors, ctx.perspective)
    return to_image, to_light, None, None, None


differentiable(light_pixels, _to_inputs, _save)


def _to_first(ctx, image, light):
    """Differentiate <image, gradient to it> + <light, gradient to it>, of colours linear in each of both."""
    grad, own_image, own_light, *maps = ctx.saved_tensors
    covered = (maps[1] >= 0)[:, None]  # the background is not lit, so it does not depend on the light
    to_grad = light_pixels(image, own_light, *maps, ctx.perspective)
    to_grad = to_grad + light_pixels(own_image, light, *maps, ctx.perspective) * covered
    to_image, _ = light_pixels_backward(grad, own_image, light, *maps, ctx.perspective)
    _, to_light = light_pixels_backward(grad, image, own_light, *maps, ctx.perspective)
    return to_grad, to_image * covered, to_light, None, None, None


differentiable(light_pixels_backward, _to_first, _save)


# Over the pixels [left, right) of the rows [first, last), with the factor on the pixel's face; the background has 1.
_PIXELS = """
    const auto visible_side = [](wp::vec_t<3, float> v0, wp::vec_t<3, float> v1, wp::vec_t<3, float> v2,
                                 int perspective) -> int { FACING };
    const int height = face_index.shape[1], width = face_index.shape[2], all = face_index.shape[0] * height;
    const wp::int64 area = (wp::int64)height * width, count = faces.shape[1];
    RANGE
    for (int row = first; row < last; ++row) {
        const int b = row / height;
        const wp::int64 lamp = b < light.shape[0] ? b : light.shape[0] - 1;
        const wp::int64 start = 2 * b * area + (wp::int64)row * width;  // of the row's first channel
        const int* shown = face_index.data + (wp::int64)row * width;
        for (int i = left; i < right;) {
            const int f = shown[i];
            int end = i + 1;
            while (end < right && shown[end] == f) ++end;
            int side = 0;
            wp::vec_t<3, float> factor(1.0f, 1.0f, 1.0f);
            if (f >= 0) {
                const wp::vec_t<3, float>* v = faces.data + (b * count + f) * 3;
                side = visible_side(v[0], v[1], v[2], perspective) < 0;
                factor = light.data[(2 * lamp + side) * count + f];
            }
            RUN
            i = end;
        }
    }
"""
_PIXELS = _PIXELS.replace("FACING", FACING)
_LIGHT = """
            for (int c = 0; c < 3; ++c)
                for (wp::int64 n = start + c * area + i; n < start + c * area + end; ++n)
                    lit.data[n] = image.data[n] * factor[c];
"""
_UNLIGHT = """
            wp::vec_t<3, float> part(0.0f);
            for (int c = 0; c < 3; ++c)
                for (wp::int64 n = start + c * area + i; n < start + c * area + end; ++n) {
                    to_image.data[n] = grad.data[n] * factor[c];
                    part[c] += grad.data[n] * image.data[n];
                }
            auto* to = to_light.data + (2 * (wp::int64)b + side) * count + f;
            if (f >= 0 && run) wp::atomic_add(to, part);
            else if (f >= 0) *to += part;
"""
_RUNS = """
    const int per_row = run ? (width + run - 1) / run : 1;
    const int first = run ? task / per_row : task * height, last = run ? first + 1 : first + height;
    const int left = run ? task % per_row * run : 0, right = run && left + run < width ? left + run : width;
"""


@wp.func_native(fill(_PIXELS, RANGE=PIXELS_OF_TASK, RUN=_LIGHT))
def light_runs(
    image: wp.array4d(dtype=float),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    task: int,
    each: int,
    lit: wp.array4d(dtype=float),
):
    """Light the pixels of a task, a run of neighbours that show one face after the other."""
    ...


@wp.func_native(fill(_PIXELS, RANGE=_RUNS, RUN=_UNLIGHT))
def unlight_runs(
    image: wp.array4d(dtype=float),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    task: int,
    grad: wp.array4d(dtype=float),
    run: int,
    to_image: wp.array4d(dtype=float),
    to_light: wp.array3d(dtype=wp.vec3),
):
    """Send the gradients of a task: ``run`` neighbouring pixels, or a whole image if it is 0."""
    ...


@wp.kernel
def _forward(
    first: int,
    image: wp.array4d(dtype=float),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    each: int,
    lit: wp.array4d(dtype=float),
):
    light_runs(image, light, faces, face_index, perspective, first + wp.tid(), each, lit)


@wp.kernel
def _backward(
    first: int,
    image: wp.array4d(dtype=float),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    grad: wp.array4d(dtype=float),
    run: int,
    to_image: wp.array4d(dtype=float),
    to_light: wp.array3d(dtype=wp.vec3),
):
    unlight_runs(image, light, faces, face_index, perspective, first + wp.tid(), grad, run, to_image, to_light)
