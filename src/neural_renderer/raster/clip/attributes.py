"""Vertex attributes, interpolated at pixels with the weights of `show_triangles`, and their change between pixels."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, gradient_of, gradient_shape, operator, save_inputs, saved_inputs
from .triangles import owner_tasks

_KERNELS = Kernels(__name__, "attributes.h")
_Attributes, _InterpolateAttributes = _KERNELS.struct("Attributes"), _KERNELS.struct("InterpolateAttributes")
_InterpolateAttributesBackward = _KERNELS.struct("InterpolateAttributesBackward")
_interpolate_attributes = _KERNELS.kernel("interpolate_attributes", _InterpolateAttributes)
_interpolate_attributes_backward = _KERNELS.kernel("interpolate_attributes_backward", _InterpolateAttributesBackward)


@operator
def interpolate_attributes(
    values: Tensor, rast: Tensor, triangles: Tensor, changes: Tensor | None, changing: int, chosen: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Interpolate values of vertices at pixels; differentiable in ``values``, ``rast`` and ``changes``.

    Args:
        values: [B or 1, V, C] float32.
        rast: As from `show_triangles`, [B, H, W, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        changes: As from `show_triangles`, or None where N is 0.
        changing: Number N of channels whose change between pixels is computed.
        chosen: These channels, [N] int32; None for the first ones.

    Returns:
        [B, H, W, C] float32, 0 without a triangle; the changes of the chosen channels, right and up in turn, [B, H, W,
        2 N].
    """
    batch, height, width, _ = rast.shape
    device = rast.device
    result = empty((batch, height, width, values.shape[2]), device)
    changes_of_result = empty((batch, height, width, 2 * changing), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    of = _of(each, values, rast, triangles, changes, changing, chosen)
    call = _InterpolateAttributes(of=of, result=result, changes_of_result=changes_of_result)
    launch(_interpolate_attributes, tasks, [call], device, worth_a_thread(each * width))
    return result, changes_of_result


@fake(interpolate_attributes)
def _(values: Tensor, rast: Tensor, changing: int) -> tuple[Tensor, Tensor]:
    shape = rast.shape[:3]
    return rast.new_empty((*shape, values.shape[2])), rast.new_empty((*shape, 2 * changing))


@gradient_of(interpolate_attributes, "values", "rast", "changes", once=True)
def interpolate_attributes_backward(
    grad: Tensor, grad_of_changes: Tensor | None, values_too: bool, *inputs: Any
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the gradients to values (empty if not ``values_too``), ``rast`` and ``changes`` (empty if None)."""
    values, rast, triangles, changes, changing, chosen = inputs
    if grad_of_changes is None:
        changing = 0
    batch, height, width, _ = rast.shape
    device = rast.device
    to_values = zeros(gradient_shape(values, values_too), device)
    to_rast, to_changes = empty(rast.shape, device), empty(gradient_shape(changes), device)
    tasks, each = pixel_tasks(batch * height, width, device)
    if values_too:
        tasks, each = owner_tasks(values.shape[0], batch, height, width, device)
    call = _InterpolateAttributesBackward(
        of=_of(each, values, rast, triangles, changes, changing, chosen),
        grad=grad,
        grad_of_changes=grad_of_changes,
        values_too=values_too,
        to_values=to_values,
        to_rast=to_rast,
        to_changes=None if changes is None else to_changes,
    )
    launch(_interpolate_attributes_backward, tasks, [call], device, worth_a_thread(each * width))
    return to_values, to_rast, to_changes


def _of(each: int, *inputs: Any) -> Call:
    """Make the `Attributes` of kernels from the inputs of `interpolate_attributes`, for tasks of ``each`` rows."""
    values, rast, triangles, changes, changing, chosen = inputs
    images, height, width, _ = rast.shape
    return _Attributes(
        values=values,
        triangles=triangles,
        rast=rast,
        changes=changes,
        chosen=chosen,
        owners=values.shape[0],
        vertices=values.shape[1],
        channels=values.shape[2],
        changing=changing,
        count=triangles.shape[0],
        images=images,
        height=height,
        width=width,
        each=each,
    )


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    save_inputs(ctx, inputs, output)
    ctx.set_materialize_grads(False)


def _to_inputs(ctx: Any, grad: Tensor | None, grad_of_changes: Tensor | None) -> Any:
    if grad is None and grad_of_changes is None:
        return {}
    inputs = saved_inputs(ctx)
    values, rast = inputs[:2]
    grad = rast.new_zeros((*rast.shape[:3], values.shape[2])) if grad is None else grad
    results = interpolate_attributes_backward(grad, grad_of_changes, ctx.needs_input_grad[0], *inputs)
    return dict(zip(("values", "rast", "changes"), results, strict=True))


differentiable(interpolate_attributes, _to_inputs, _save)
