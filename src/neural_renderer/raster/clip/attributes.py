"""Attributes of vertices at every pixel, from the weights of `show_triangles`, and their change between pixels."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, differentiable_once, fake, operator
from .triangles import owner_tasks

_KERNELS = Kernels(__name__, "attributes.h")
_Attributes, _InterpolateAttributes = _KERNELS.struct("Attributes"), _KERNELS.struct("InterpolateAttributes")
_InterpolateAttributesBackward = _KERNELS.struct("InterpolateAttributesBackward")
_interpolate_attributes = _KERNELS.kernel("interpolate_attributes", _InterpolateAttributes)
_interpolate_attributes_backward = _KERNELS.kernel("interpolate_attributes_backward", _InterpolateAttributesBackward)


@operator
def interpolate_attributes(
    values: Tensor, rast: Tensor, triangles: Tensor, changes: Tensor | None, chosen: Tensor
) -> tuple[Tensor, Tensor]:
    """Interpolate values of vertices at pixels; differentiable in ``values``, ``rast`` and ``changes``.

    Args:
        values: [B or 1, V, C] float32.
        rast: As from `show_triangles`, [B, H, W, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        changes: As from `show_triangles`, or None without ``chosen`` channels.
        chosen: Channels whose change by one pixel is asked for, [N] int32.

    Returns:
        [B, H, W, C] float32, 0 without a triangle; the changes of the chosen channels, right and up in turn, [B, H, W,
        2 N].
    """
    batch, height, width, _ = rast.shape
    device = rast.device
    result = empty((batch, height, width, values.shape[2]), device)
    changes_of_result = empty((batch, height, width, 2 * len(chosen)), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    of = _of(values, rast, triangles, changes, chosen, each)
    call = _InterpolateAttributes(of=of, result=result, changes_of_result=changes_of_result)
    launch(_interpolate_attributes, tasks, [call], device, worth_a_thread(each * width))
    return result, changes_of_result


@fake(interpolate_attributes)
def _(values: Tensor, rast: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    shape = rast.shape[:3]
    return rast.new_empty((*shape, values.shape[2])), rast.new_empty((*shape, 2 * len(chosen)))


@differentiable_once
def interpolate_attributes_backward(
    grad: Tensor,
    grad_of_changes: Tensor,
    values: Tensor,
    rast: Tensor,
    triangles: Tensor,
    changes: Tensor | None,
    chosen: Tensor,
    values_too: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the gradients to values, ``rast`` and ``changes``; empty if not ``values_too``, and for no changes."""
    batch, height, width, _ = rast.shape
    device = rast.device
    to_values = zeros(values.shape if values_too else (0, 0, 0), device)
    to_rast = empty(rast.shape, device)
    to_changes = empty(rast.shape if changes is not None else (0, 0, 0, 4), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    if values_too:
        tasks, each = owner_tasks(len(values), batch, height, width, device)
    call = _InterpolateAttributesBackward(
        of=_of(values, rast, triangles, changes, chosen, each),
        grad=grad.contiguous(),
        grad_of_changes=grad_of_changes.contiguous(),
        values_too=int(values_too),
        to_values=to_values,
        to_rast=to_rast,
        to_changes=None if changes is None else to_changes,
    )
    launch(_interpolate_attributes_backward, tasks, [call], device, worth_a_thread(each * width))
    return to_values, to_rast, to_changes


@fake(interpolate_attributes_backward)
def _(values: Tensor, rast: Tensor, changes: Tensor | None, values_too: bool) -> tuple[Tensor, Tensor, Tensor]:
    return (
        values.new_empty(values.shape if values_too else (0, 0, 0)),
        rast.new_empty(rast.shape),
        rast.new_empty(rast.shape if changes is not None else (0, 0, 0, 4)),
    )


def _of(values: Tensor, rast: Tensor, triangles: Tensor, changes: Tensor | None, chosen: Tensor, each: int) -> Call:
    images, height, width, _ = rast.shape
    return _Attributes(
        values=values.contiguous(),
        triangles=triangles.contiguous(),
        rast=rast.contiguous(),
        changes=None if changes is None else changes.contiguous(),
        chosen=chosen.contiguous(),
        owners=len(values),
        vertices=values.shape[1],
        channels=values.shape[2],
        changing=len(chosen),
        count=len(triangles),
        images=images,
        height=height,
        width=width,
        each=each,
    )


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    values, rast, triangles, changes, chosen = inputs
    ctx.save_for_backward(values, rast, triangles, changes, chosen)


def _to_inputs(ctx: Any, grad: Tensor, grad_of_changes: Tensor) -> Any:
    values, rast, triangles, changes, chosen = ctx.saved_tensors
    values_too, rast_too, _, changes_too, _ = ctx.needs_input_grad
    to_values, to_rast, to_changes = interpolate_attributes_backward(
        grad, grad_of_changes, values, rast, triangles, changes, chosen, values_too
    )
    return (
        to_values if values_too else None,
        to_rast if rast_too else None,
        None,
        to_changes if changes_too else None,
        None,
    )


differentiable(interpolate_attributes, _to_inputs, _save)


def all_channels(count: int, device: torch.device) -> Tensor:
    """Make ``chosen`` for all of ``count`` channels."""
    return torch.arange(count, dtype=torch.int32, device=device)
