"""Lit colours over a background: the colour of each pixel times the light on the visible side of its face."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any, Optional

from torch import Tensor

from ..ops.visible_faces import scene_of
from ..warp.launch import launch, launch_pixels
from ..warp.layout import in_any_order, pixel_tasks, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from ..warp.registration import (
    differentiable,
    fake,
    forward_operator,
    gradient_of,
    in_direction,
    operator,
    save_inputs,
    saved_inputs,
    sum_of,
)
from .composite import background_of, behind_faces, grad_of

_KERNELS = Kernels(__name__, "light_pixels.h")
_LightPixels, _LightPixelsBackward = _KERNELS.struct("LightPixels"), _KERNELS.struct("LightPixelsBackward")
_FORWARD = Kernels(__name__ + ".forward", "light_pixels.h")
_LightPixelsForward = _FORWARD.struct("LightPixelsForward")
_light_pixels = _KERNELS.kernel("light_pixels", _LightPixels)
_light_pixels_backward = _KERNELS.kernel("light_pixels_backward", _LightPixelsBackward)
_light_pixels_forward = _FORWARD.kernel("light_pixels_forward", _LightPixelsForward)


@operator
def light_pixels(
    colors: Tensor, background: Tensor, light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool
) -> Tensor:
    """Apply `composite` to colours [B, H, W, 3] float32 times the light on faces; differentiable in all three.

    Args:
        background: As in `composite`; it is not lit.
        light: Factors on the front and the back of each face, [1 or B, 2, F, 3] float32. On the front, corners run
            counter-clockwise on the screen.
        faces, face_index, perspective: As in `barycentrics`.
    """
    batch, height, width = face_index.shape
    image = empty((batch, 3, height, width), colors.device)
    fields = _fields(colors, light, faces, face_index, perspective)
    fields |= {"background": background_of(background.expand(image.shape)), "image": image}
    launch_pixels(_light_pixels, _LightPixels, batch * height, width, colors.device, **fields)
    return image


def _fields(colors: Tensor, light: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> dict[str, Any]:
    scene = scene_of(faces, face_index, perspective)
    return {"scene": scene, "colors": colors, "light": light, "lamps": len(light)}


@fake(light_pixels)
def _(colors: Tensor, face_index: Tensor) -> Tensor:
    batch, height, width = face_index.shape
    return colors.new_empty((batch, 3, height, width))


@gradient_of(light_pixels, "colors", "light", leave_out="background")
def light_pixels_backward(grad: Tensor, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `light_pixels` to the colours, and to the light, [1 or B, 2, F, 3] float32.

    ``grad`` as for `grad_of`.
    """
    _, light, _, face_index, _ = inputs
    batch, height, width = face_index.shape
    to_colors = empty((batch, height, width, 3), grad.device)
    to_light = zeros((batch, 2, light.shape[2], 3), grad.device)
    # Deterministic sums, and the CPU: one task per image (run = 0 means all rows).
    tasks, run = run_tasks(batch * height, width) if in_any_order(grad.device) else (batch, 0)
    call = _LightPixelsBackward(
        forward=_LightPixels(**_fields(*inputs)),
        grad=grad_of(grad, face_index),
        run=run,
        to_colors=to_colors,
        to_light=to_light,
    )
    launch(_light_pixels_backward, tasks, [call], grad.device, worth_a_thread(height * width))
    return to_colors, to_light.sum(0, keepdim=True) if light.shape[0] < batch else to_light


@forward_operator(2, light_pixels, leave_out="background")
def light_pixels_forward(
    to_colors: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    to_light: Optional[Tensor],  # noqa: UP045
    *inputs: Any,
) -> Tensor:
    """Compute the tangent [T, B, 3, H, W] of `light_pixels` over a constant background.

    ``to_colors`` and ``to_light`` are tangents of the colours, [T, B, H, W, 3] float32, and of the light, [T, B or 1,
    2, F, 3] float32; one may be None.
    """
    batch, height, width = inputs[3].shape
    given = to_light if to_colors is None else to_colors
    count = 0 if given is None else len(given)
    change = empty((count, batch, 3, height, width), inputs[0].device)
    tasks, each = pixel_tasks(batch * height, width, change.device)
    forward = _LightPixels(each=each, **_fields(*inputs))
    call = _LightPixelsForward(forward=forward, to_colors=to_colors, to_light=to_light, directions=count, change=change)
    launch(_light_pixels_forward, tasks, [call], change.device, worth_a_thread(each * width * count))
    return change


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    colors, background, *others = inputs
    ctx.behind = background.shape
    save_inputs(ctx, (colors, *others), output)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    inputs, found = saved_inputs(ctx), {}
    if ctx.needs_input_grad[0] or ctx.needs_input_grad[2]:
        found["colors"], found["light"] = light_pixels_backward(grad, *inputs)
    if ctx.needs_input_grad[1]:
        found["background"] = behind_faces(grad, inputs[3]).sum_to_size(ctx.behind)
    return found


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    colors, _, *options = inputs
    to_colors, to_background, to_light = tangents[:3]
    parts = []
    if to_colors is not None or to_light is not None:
        parts.append(in_direction(light_pixels_forward, (to_colors, to_light), colors, *options))
    if to_background is not None:
        parts.append(behind_faces(to_background, options[2]))
    return sum_of(parts)


def _over_black(colors: Tensor, light: Tensor, *options: Any) -> Tensor:
    return light_pixels(colors, colors.new_zeros((1, 3, 1, 1)), light, *options)


differentiable(light_pixels, _to_inputs, _save, _forward)


def _to_first(ctx: Any, colors: Tensor, light: Tensor) -> Any:
    """Differentiate both gradients, times ``colors`` and ``light``; the image is linear in each."""
    grad, own_colors, own_light, *options = saved_inputs(ctx)
    to_grad = _over_black(colors, own_light, *options) + _over_black(own_colors, light, *options)
    to_colors, _ = light_pixels_backward(grad, own_colors, light, *options)
    _, to_light = light_pixels_backward(grad, colors, own_light, *options)
    return {"grad": to_grad, "colors": to_colors, "light": to_light}


differentiable(light_pixels_backward, _to_first, save_inputs)
