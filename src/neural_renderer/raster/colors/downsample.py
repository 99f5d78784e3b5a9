"""Downsampling of anti-aliased images: the mean of 2 x 2 pixels."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from ..ops.coverage import KERNELS, silhouette
from ..warp.elementwise import copy, quarter
from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import contiguous, empty, zeros
from ..warp.registration import differentiable, fake, is_plain, operator

_Halve = KERNELS.struct("Halve")
_average_blocks = KERNELS.kernel("average_blocks", _Halve)
_average_blocks_backward = KERNELS.kernel("average_blocks_backward", _Halve)


@operator
def halve(image: Tensor) -> Tensor:
    """Average 2 x 2 blocks of an image [B, C, H, W] float32 with even sides; differentiable."""
    batch, channels, height, width = image.shape
    means = empty((batch, channels, height // 2, width // 2), image.device)
    _launch(_average_blocks, image, means)
    return means


@operator
def halve_backward(grad: Tensor) -> Tensor:
    """Send a quarter of each gradient to each pixel of its block: the transpose of `halve`."""
    batch, channels, height, width = grad.shape
    to_image = empty((batch, channels, 2 * height, 2 * width), grad.device)
    _launch(_average_blocks_backward, to_image, grad)
    return to_image


def in_blocks(wanted: bool, call: Any, *inputs: Any) -> Tensor:
    """Call an operator that makes an image [B, C, H, W]; if ``wanted``, return [B, C, H / 2, 2, W / 2, 2].

    If all pixels of a block have the same gradient, like that of their mean, it then reaches the operator's backward
    pass at half the size. Outside plain reverse mode the image keeps its shape.
    """
    if not (wanted and torch.is_grad_enabled() and is_plain(inputs)):
        return call(*inputs)
    return _in_blocks(call.graph[0]).apply(*inputs)


@cache
def _in_blocks(function: Any) -> Any:
    """Derive the `torch.autograd.Function` of `in_blocks` from that of the operator."""

    def forward(ctx: Any, *inputs: Any) -> Tensor:
        return function.forward(ctx, *inputs).unflatten(3, (-1, 2)).unflatten(2, (-1, 2))

    def backward(ctx: Any, grad: Tensor) -> Any:
        equal = grad.stride(3) == grad.stride(5) == 0 and not torch.is_grad_enabled()  # a second derivative needs all
        return function.backward(ctx, grad[:, :, :, 0, :, 0] if equal else whole(grad))

    methods = {"forward": staticmethod(forward), "backward": staticmethod(backward)}
    return type(function.__name__, (torch.autograd.Function,), methods)


def whole(image: Tensor) -> Tensor:
    """Reshape an image in blocks, as from `in_blocks`, to [B, C, H, W]; other images are returned unchanged."""
    return image if image.dim() < 6 else image.flatten(4).flatten(2, 3)


def spread(grad: Tensor, blocks: bool) -> Tensor:
    """Give each pixel of a 2 × 2 block a quarter of its gradient; with ``blocks``, keep the dimensions of blocks."""
    if not blocks:
        return halve_backward(grad)
    return quarter(grad)[:, :, :, None, :, None].expand(-1, -1, -1, 2, -1, 2)


def averaged(image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
    """Copy an image, or average its 2 x 2 blocks if ``halved``; None stands for the silhouette of ``face_index``."""
    if image is None:
        return silhouette(face_index, halved)
    return halve(image) if halved else copy(image)


def changes_averaged(
    changes: Tensor | None, directions: int, image: Tensor | None, face_index: Tensor, halved: bool
) -> Tensor:
    """Copy or average the tangents of an image, [T, B, C, H, W]; those of a silhouette are 0."""
    if changes is not None:
        return averaged(changes.flatten(0, 1), face_index, halved).unflatten(0, changes.shape[:2])
    batch, height, width = face_index.shape
    scale, channels = 2 if halved else 1, 1 if image is None else image.shape[1]
    return zeros((directions, batch, channels, height // scale, width // scale), face_index.device)


def change_averaged(change: Tensor | None, halved: bool) -> Tensor | None:
    """Average the tangent of an image, outside an operator: the forward mode of `averaged`."""
    return halve(change) if halved and change is not None else change


def like_averaged(image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
    """Make an empty tensor of the shape that `averaged` returns."""
    batch, height, width = face_index.shape
    scale, channels = 2 if halved else 1, 1 if image is None else image.shape[1]
    return face_index.new_empty((batch, channels, height // scale, width // scale), dtype=torch.float32)


def _launch(kernel: wp.Kernel, image: Tensor, means: Tensor) -> None:
    rows, width = means.shape[:3].numel(), means.shape[3]
    tasks, each = pixel_tasks(rows, width, image.device)
    call = _Halve(image=contiguous(image), means=contiguous(means), rows=rows, width=width, each=each)
    launch(kernel, tasks, [call], image.device, worth_a_thread(each * width))


@fake(halve)
def _(image: Tensor) -> Tensor:
    return image.new_empty((*image.shape[:2], image.shape[2] // 2, image.shape[3] // 2))


@fake(halve_backward)
def _(grad: Tensor) -> Tensor:
    return grad.new_empty((*grad.shape[:2], 2 * grad.shape[2], 2 * grad.shape[3]))


differentiable(halve, lambda ctx, grad: halve_backward(grad), None, lambda inputs, tangents: halve(tangents[0]))
differentiable(
    halve_backward, lambda ctx, image: halve(image), None, lambda inputs, tangents: halve_backward(tangents[0])
)
