"""Light on an image: the colour of each pixel times the light on the visible side of its face."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import facing
from ..warp.launch import array, launch, zeros
from ..warp.layout import concurrent, in_any_order, worth_a_thread
from ..warp.registration import differentiable, differentiable_once, operator

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
    lit = torch.empty_like(image, memory_format=torch.contiguous_format)
    arguments = [array(image), array(light, wp.vec3), array(faces, wp.vec3), array(face_index), int(perspective)]
    launch(_forward, batch * height, [*arguments, array(lit)], image.device, worth_a_thread(width))
    return lit


@torch.library.register_fake("neural_renderer::light_pixels")
def _(image, light, faces, face_index, perspective):  # type: ignore[no-untyped-def]
    return torch.empty_like(image, memory_format=torch.contiguous_format)


@differentiable_once
def light_pixels_backward(
    grad: Tensor, image: Tensor, light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `light_pixels` to the image, and to the light, [1 or B, 2, F, 3] float32."""
    batch, height, width = face_index.shape
    count = light.shape[2]
    to_image = torch.empty_like(grad, memory_format=torch.contiguous_format)
    to_light = zeros((batch, 2, count, 3), grad.device)
    # On the CPU, and where the order of sums must not vary, one task takes all rows of an image.
    rows = 1 if in_any_order(grad.device) else max(height, 1)
    arguments = [array(image), array(light, wp.vec3), array(faces, wp.vec3), array(face_index), int(perspective)]
    arguments += [array(grad), rows, int(concurrent(grad.device)), array(to_image), array(to_light, wp.vec3)]
    launch(_backward, batch * height // rows, arguments, grad.device, worth_a_thread(rows * width))
    return to_image, to_light.sum(0, keepdim=True) if light.shape[0] < batch else to_light


@torch.library.register_fake("neural_renderer::light_pixels_backward")
def _(grad, image, light, faces, face_index, perspective):  # type: ignore[no-untyped-def]
    return torch.empty_like(grad, memory_format=torch.contiguous_format), torch.empty_like(light)


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    *tensors, ctx.perspective = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx, grad):  # type: ignore[no-untyped-def]
    to_image, to_light = light_pixels_backward(grad, *ctx.saved_tensors, ctx.perspective)
    return to_image, to_light, None, None, None


differentiable(light_pixels, _to_inputs, _save)


@wp.func
def side_of(faces: wp.array3d(dtype=wp.vec3), b: int, f: int, perspective: int) -> int:
    """Tell which side of a face is visible: 1 if it is the back, else 0."""
    return int(facing(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], perspective) < 0)


@wp.kernel
def _forward(
    first: int,
    image: wp.array4d(dtype=float),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    lit: wp.array4d(dtype=float),
):
    """One row, counted over all images."""
    task = first + wp.tid()
    b = task // face_index.shape[1]
    j = task % face_index.shape[1]
    lamp = wp.min(b, light.shape[0] - 1)
    last = int(-1)
    factor = wp.vec3(1.0, 1.0, 1.0)
    for i in range(face_index.shape[2]):
        f = face_index[b, j, i]
        if f != last:
            factor = wp.vec3(1.0, 1.0, 1.0)
            if f >= 0:
                factor = light[lamp, side_of(faces, b, f, perspective), f]
            last = f
        lit[b, 0, j, i] = image[b, 0, j, i] * factor[0]
        lit[b, 1, j, i] = image[b, 1, j, i] * factor[1]
        lit[b, 2, j, i] = image[b, 2, j, i] * factor[2]


@wp.func
def add(to_light: wp.array3d(dtype=wp.vec3), b: int, side: int, f: int, part: wp.vec3, shared: int):
    """Add to the gradient of a face; ``shared``: other tasks may add to it, too."""
    if shared == 1:
        wp.atomic_add(to_light, b, side, f, part)
    else:
        to_light[b, side, f] = to_light[b, side, f] + part


@wp.kernel
def _backward(
    first: int,
    image: wp.array4d(dtype=float),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    grad: wp.array4d(dtype=float),
    rows: int,
    shared: int,
    to_image: wp.array4d(dtype=float),
    to_light: wp.array3d(dtype=wp.vec3),
):
    """``rows`` rows of one image. Neighbouring pixels of one face are added up first."""
    task = first + wp.tid()
    tasks = face_index.shape[1] // rows
    b = task // tasks
    lamp = wp.min(b, light.shape[0] - 1)
    for j in range((task % tasks) * rows, (task % tasks + 1) * rows):
        last = int(-1)
        side = int(0)
        factor = wp.vec3(1.0, 1.0, 1.0)
        part = wp.vec3(0.0, 0.0, 0.0)
        for i in range(face_index.shape[2]):
            f = face_index[b, j, i]
            if f != last:
                if last >= 0:
                    add(to_light, b, side, last, part, shared)
                factor = wp.vec3(1.0, 1.0, 1.0)
                part = wp.vec3(0.0, 0.0, 0.0)
                if f >= 0:
                    side = side_of(faces, b, f, perspective)
                    factor = light[lamp, side, f]
                last = f
            g = wp.vec3(grad[b, 0, j, i], grad[b, 1, j, i], grad[b, 2, j, i])
            part += wp.cw_mul(g, wp.vec3(image[b, 0, j, i], image[b, 1, j, i], image[b, 2, j, i]))
            to_image[b, 0, j, i] = g[0] * factor[0]
            to_image[b, 1, j, i] = g[1] * factor[1]
            to_image[b, 2, j, i] = g[2] * factor[2]
        if last >= 0:
            add(to_light, b, side, last, part, shared)
