"""Compositing: the colours of visible faces over a background."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch_pixels
from ..warp.memory import empty
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, forward_operator, in_direction, operator, sum_of

_KERNELS = Kernels(__name__, "composite.h")
_Background = _KERNELS.struct("Background")
_ImageGrad = _KERNELS.struct("ImageGrad")
_Composite, _CompositeBackward = _KERNELS.struct("Composite"), _KERNELS.struct("CompositeBackward")
_composite_pixels = _KERNELS.kernel("composite_pixels", _Composite)
_composite_pixels_backward = _KERNELS.kernel("composite_pixels_backward", _CompositeBackward)


def background_of(background: Tensor) -> Call:
    """Make the `Background` of kernels: [B, C, H, W] float32 with any strides; it is not copied."""
    if background.numel() == 0:
        return _Background()
    image, channel, row, column = background.stride()
    # A view of the first element is contiguous.
    first = background.as_strided((), ())
    return _Background(values=first, image=image, channel=channel, row=row, column=column)


def grad_of(grad: Tensor, face_index: Tensor) -> Call:
    """Make the `ImageGrad` of kernels: the gradient to images, or, at half their size, to blocks of 2 x 2 pixels."""
    height, width = face_index.shape[1:]
    return _ImageGrad(values=grad, halved=grad.shape[3] < width, height=height, width=width)


def behind_faces(grad: Tensor, face_index: Tensor) -> Tensor:
    """Return the gradient or tangent of a background: that of an image where no face is visible."""
    if grad.shape[2:] != (1, 1) and grad.shape[3] < face_index.shape[2]:
        grad = grad.repeat_interleave(2, 2).repeat_interleave(2, 3)
    return grad * (face_index < 0)[:, None]


@operator
def composite(colors: Tensor, background: Tensor, face_index: Tensor) -> Tensor:
    """Put colours [B, H, W, C] float32 over a background [1 or B, C, 1 or H, 1 or W] float32; differentiable in both.

    The background shows where ``face_index`` [B, H, W] int32 is -1. Returns [B, C, H, W] float32.
    """
    return _put_over(colors, background, face_index, 1)


def _put_over(colors: Tensor, background: Tensor, face_index: Tensor, repeats: int) -> Tensor:
    """Apply `composite` to colours [repeats B, H, W, C]: several times for the faces of B images."""
    batch, height, width = face_index.shape
    image = empty((repeats * batch, colors.shape[3], height, width), colors.device)
    behind = background_of(background.expand(image.shape))
    fields = _fields(face_index, colors.shape[3]) | {"images": len(image), "repeats": repeats}
    fields |= {"colors": colors, "background": behind, "image": image}
    launch_pixels(_composite_pixels, _Composite, len(image) * height, width, colors.device, **fields)
    return image


@fake(composite)
def _(colors: Tensor, face_index: Tensor) -> Tensor:
    batch, height, width = face_index.shape
    return colors.new_empty((batch, colors.shape[3], height, width))


@forward_operator(1)
def composite_forward(to_colors: Tensor, face_index: Tensor) -> Tensor:
    """Compute the tangent [T, B, C, H, W] of `composite` for tangents of the colours, [T, B, H, W, C] float32."""
    directions, images = to_colors.shape[:2]
    black = to_colors.new_zeros((1, 1, 1, 1))
    return _put_over(to_colors.flatten(0, 1), black, face_index, directions).unflatten(0, (directions, images))


@fake(composite_forward)
def _(to_colors: Tensor) -> Tensor:
    return torch.empty_like(to_colors.movedim(4, 2), memory_format=torch.contiguous_format)


@operator
def composite_backward(grad: Tensor, face_index: Tensor) -> Tensor:
    """Compute the gradient of `composite` to the colours, [B, H, W, C] float32; ``grad`` as for `grad_of`."""
    channels, (batch, height, width) = grad.shape[1], face_index.shape
    to_colors = empty((batch, height, width, channels), grad.device)
    fields = _fields(face_index, channels) | {"grad": grad_of(grad, face_index), "to_colors": to_colors}
    launch_pixels(_composite_pixels_backward, _CompositeBackward, batch * height, width, grad.device, **fields)
    return to_colors


def _fields(face_index: Tensor, channels: int) -> dict[str, Any]:
    images, height, width = face_index.shape
    return {"face_index": face_index, "images": images, "channels": channels, "height": height, "width": width}


@fake(composite_backward)
def _(grad: Tensor, face_index: Tensor) -> Tensor:
    return grad.new_empty((*face_index.shape, grad.shape[1]))


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    _, background, face_index = inputs
    ctx.behind = background.shape
    ctx.save_for_backward(face_index)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    face_index, found = ctx.saved_tensors[0], {}
    if ctx.needs_input_grad[0]:
        found["colors"] = composite_backward(grad, face_index)
    if ctx.needs_input_grad[1]:
        found["background"] = behind_faces(grad, face_index).sum_to_size(ctx.behind)
    return found


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    face_index = inputs[2]
    to_colors, to_background, _ = tangents
    parts = [] if to_background is None else [behind_faces(to_background, face_index)]
    if to_colors is not None:
        parts.append(in_direction(composite_forward, (to_colors,), face_index))
    return sum_of(parts)


differentiable(composite, _to_inputs, _save, _forward)


def _save_again(ctx: Any, inputs: Any, output: Any) -> None:
    ctx.save_for_backward(inputs[1])


def _to_gradient(ctx: Any, colors: Tensor) -> Any:
    return composite(colors, colors.new_zeros((1, colors.shape[3], 1, 1)), ctx.saved_tensors[0]), None


differentiable(
    composite_backward,
    _to_gradient,
    _save_again,
    lambda inputs, tangents: composite_backward(tangents[0], inputs[1]),
)
