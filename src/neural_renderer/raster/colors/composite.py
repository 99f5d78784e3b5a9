"""Compositing: the colours of visible faces over a background."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import empty
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, operator

_KERNELS = Kernels(__name__, "composite.h")
_Background = _KERNELS.struct("Background")
_ImageGrad = _KERNELS.struct("ImageGrad")
_Composite, _CompositeBackward = _KERNELS.struct("Composite"), _KERNELS.struct("CompositeBackward")
_composite_pixels = _KERNELS.kernel("composite_pixels", _Composite)
_composite_pixels_backward = _KERNELS.kernel("composite_pixels_backward", _CompositeBackward)


def background_of(background: Tensor) -> Call:
    """Make the `Background` of kernels: [B, C, H, W] float32 with any strides, which stays where it is in memory."""
    if background.numel() == 0:
        return _Background()
    image, channel, row, column = background.stride()
    # A view of the first number alone is contiguous.
    first = background.as_strided((), ())
    return _Background(values=first, image=image, channel=channel, row=row, column=column)


def grad_of(grad: Tensor, face_index: Tensor) -> Call:
    """Make the `ImageGrad` of kernels: the gradient to images, or if it is half their size, to blocks of pixels."""
    height, width = face_index.shape[1:]
    return _ImageGrad(values=grad.contiguous(), halved=int(grad.shape[3] < width), height=height, width=width)


def behind_faces(grad: Tensor, face_index: Tensor) -> Tensor:
    """Return the gradient, or change, of a background: that of an image where no face is visible."""
    if grad.shape[2:] != (1, 1) and grad.shape[3] < face_index.shape[2]:
        grad = grad.repeat_interleave(2, 2).repeat_interleave(2, 3)
    return grad * (face_index < 0)[:, None]


@operator
def composite(colors: Tensor, background: Tensor, face_index: Tensor) -> Tensor:
    """Put colours [B, H, W, C] float32 over a background [1 or B, C, 1 or H, 1 or W] float32; differentiable in both.

    The background shows where ``face_index`` [B, H, W] int32 is -1. Returns [B, C, H, W] float32.
    """
    batch, height, width = face_index.shape
    image = empty((batch, colors.shape[3], height, width), colors.device)
    tasks, each = pixel_tasks(batch * height, width, colors.device)
    call = _Composite(
        colors=colors.contiguous(),
        background=background_of(background.expand(image.shape)),
        face_index=face_index.contiguous(),
        images=batch,
        channels=colors.shape[3],
        height=height,
        width=width,
        each=each,
        image=image,
    )
    launch(_composite_pixels, tasks, [call], colors.device, worth_a_thread(each * width))
    return image


@fake(composite)
def _(colors: Tensor, face_index: Tensor) -> Tensor:
    batch, height, width = face_index.shape
    return colors.new_empty((batch, colors.shape[3], height, width))


@operator
def composite_backward(grad: Tensor, face_index: Tensor) -> Tensor:
    """Compute the gradient of `composite` to the colours, [B, H, W, C] float32; ``grad`` as of `grad_of`."""
    channels, (batch, height, width) = grad.shape[1], face_index.shape
    to_colors = empty((batch, height, width, channels), grad.device)
    tasks, each = pixel_tasks(batch * height, width, grad.device)
    call = _CompositeBackward(
        grad=grad_of(grad, face_index),
        face_index=face_index.contiguous(),
        images=batch,
        channels=channels,
        height=height,
        width=width,
        each=each,
        to_colors=to_colors,
    )
    launch(_composite_pixels_backward, tasks, [call], grad.device, worth_a_thread(each * width))
    return to_colors


@fake(composite_backward)
def _(grad: Tensor, face_index: Tensor) -> Tensor:
    return grad.new_empty((*face_index.shape, grad.shape[1]))


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    _, background, face_index = inputs
    ctx.behind = background.shape
    ctx.save_for_backward(face_index)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    face_index = ctx.saved_tensors[0]
    to_colors = composite_backward(grad, face_index) if ctx.needs_input_grad[0] else None
    to_background = None
    if ctx.needs_input_grad[1]:
        to_background = behind_faces(grad, face_index).sum_to_size(ctx.behind)
    return to_colors, to_background, None


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    _, background, face_index = inputs
    to_colors, to_background, _ = tangents
    if to_colors is None:
        return behind_faces(to_background, face_index)
    return composite(to_colors, torch.zeros_like(background) if to_background is None else to_background, face_index)


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
