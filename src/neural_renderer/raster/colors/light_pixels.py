"""Light on an image: the colour of each pixel times the light on the visible side of its face."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..ops.visible_faces import scene_of
from ..warp.launch import launch
from ..warp.layout import in_any_order, pixel_tasks, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from ..warp.registration import differentiable, fake, operator, sum_of

_KERNELS = Kernels(__name__, "light_pixels.h")
_LightPixels, _LightPixelsBackward = _KERNELS.struct("LightPixels"), _KERNELS.struct("LightPixelsBackward")
_light_pixels = _KERNELS.kernel("light_pixels", _LightPixels)
_light_pixels_backward = _KERNELS.kernel("light_pixels_backward", _LightPixelsBackward)


@operator
def light_pixels(image: Tensor, light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> Tensor:
    """Multiply an image [B, 3, H, W] float32 by the light on faces; differentiable in both.

    Args:
        light: Factors on the front and the back of each face, [1 or B, 2, F, 3] float32. On the front, corners run
            counter-clockwise on the screen.
        faces, face_index, perspective: As in `barycentrics`. Where no face is visible, the image stays as it is.
    """
    batch, height, width = face_index.shape
    lit = empty(image.shape, image.device)
    tasks, each = pixel_tasks(batch * height, width, image.device)
    call = _LightPixels(
        scene=scene_of(faces, face_index, perspective),
        image=image.contiguous(),
        light=light.contiguous(),
        lamps=len(light),
        each=each,
        lit=lit,
    )
    launch(_light_pixels, tasks, [call], image.device, worth_a_thread(each * width))
    return lit


@fake(light_pixels)
def _(image: Tensor) -> Tensor:
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
    scene = scene_of(faces, face_index, perspective)
    given = _LightPixels(scene=scene, image=image.contiguous(), light=light.contiguous(), lamps=len(light))
    # Deterministic sums, and the CPU: one task per image (run = 0 means all rows).
    tasks, run = run_tasks(batch * height, width) if in_any_order(grad.device) else (batch, 0)
    call = _LightPixelsBackward(forward=given, grad=grad.contiguous(), run=run, to_image=to_image, to_light=to_light)
    launch(_light_pixels_backward, tasks, [call], grad.device, worth_a_thread(height * width))
    return to_image, to_light.sum(0, keepdim=True) if light.shape[0] < batch else to_light


@fake(light_pixels_backward)
def _(grad: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
    return torch.empty_like(grad, memory_format=torch.contiguous_format), torch.empty_like(light)


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    *tensors, ctx.perspective = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    image, light, faces, face_index = ctx.saved_tensors
    to_image, to_light = light_pixels_backward(grad, image, light, faces, face_index, ctx.perspective)
    return to_image, to_light, None, None, None


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    image, light, *options = inputs
    to_image, to_light = tangents[:2]
    parts = []
    if to_image is not None:
        parts.append(light_pixels(to_image, light, *options))
    if to_light is not None:
        parts.append(_by_light(image, to_light, *options))
    return sum_of(parts)


def _by_light(image: Tensor, to_light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> Tensor:
    """Compute the change of `light_pixels` with the light; the background is not lit, so it does not depend on it."""
    return light_pixels(image, to_light, faces, face_index, perspective) * (face_index >= 0)[:, None]


differentiable(light_pixels, _to_inputs, _save, _forward)


def _to_first(ctx: Any, image: Tensor, light: Tensor) -> Any:
    """Differentiate <image, its gradient> + <light, its gradient>; colours are linear in image and in light."""
    grad, own_image, own_light, faces, face_index = ctx.saved_tensors
    to_grad = light_pixels(image, own_light, faces, face_index, ctx.perspective)
    to_grad = to_grad + _by_light(own_image, light, faces, face_index, ctx.perspective)
    to_image, _ = light_pixels_backward(grad, own_image, light, faces, face_index, ctx.perspective)
    _, to_light = light_pixels_backward(grad, image, own_light, faces, face_index, ctx.perspective)
    return to_grad, to_image * (face_index >= 0)[:, None], to_light, None, None, None


differentiable(light_pixels_backward, _to_first, _save)
