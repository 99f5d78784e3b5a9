"""Interpolation of corner attributes at every pixel."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from ..ops.barycentrics import motion_of
from ..ops.visible_faces import scene_of, visible_faces
from ..warp import registration
from ..warp.launch import launch, launch_pixels
from ..warp.layout import face_tasks, in_any_order, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Kernels

# No fused multiply-adds, as in `barycentrics`, so that the weights are bitwise equal.
_KERNELS = Kernels(__name__, "interpolate.h", fused=False)
_Interpolate, _InterpolateBackward = _KERNELS.struct("Interpolate"), _KERNELS.struct("InterpolateBackward")
_FORWARD = Kernels(__name__ + ".forward", "interpolate.h", fused=False)
_InterpolateForward = _FORWARD.struct("InterpolateForward")
_interpolate_pixels = _KERNELS.kernel("interpolate_pixels", _Interpolate)
_attributes_of_face_backward = _KERNELS.kernel("attributes_of_face_backward", _InterpolateBackward)
_attributes_of_run_backward = _KERNELS.kernel("attributes_of_run_backward", _InterpolateBackward, only_cuda=True)
_interpolate_pixels_forward = _FORWARD.kernel("interpolate_pixels_forward", _InterpolateForward)


@registration.operator
def interpolate(
    attributes: Tensor, faces: Tensor, face_index: Tensor, perspective: bool, below: int = 0, above: int = 0
) -> Tensor:
    """Interpolate corners' attributes [B or 1, F, 3, C] float32 at pixels, [B, H, W, C]; differentiable, also in faces.

    The weights of `barycentrics` are recomputed, here and in the backward pass, because storing them would be slower.
    The other arguments are as there. The result is 0 where no face is visible.
    """
    batch, height, width = face_index.shape
    result = empty((batch, height, width, attributes.shape[3]), faces.device)
    fields = _fields(attributes, faces, face_index, perspective, below, above)
    launch_pixels(_interpolate_pixels, _Interpolate, batch * height, width, faces.device, **fields, result=result)
    return result


def _fields(attributes: Tensor, *scene: Any) -> dict[str, Any]:
    """List the fields of kernels from the inputs of `interpolate`."""
    owners, channels = len(attributes), attributes.shape[3]
    return {"scene": scene_of(*scene), "attributes": attributes, "owners": owners, "channels": channels}


@registration.fake(interpolate)
def _(attributes: Tensor, faces: Tensor, face_index: Tensor) -> Tensor:
    return faces.new_empty((*face_index.shape, attributes.shape[3]))


@registration.gradient_of(interpolate, "attributes", "faces")
def interpolate_backward(grad: Tensor, faces_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `interpolate` to attributes and to faces, [B, F, 3, 3]; empty if not ``faces_too``."""
    attributes, faces, face_index, *_ = inputs
    batch, height, width = face_index.shape
    count = faces.shape[1]
    to_attributes = zeros(attributes.shape, faces.device)
    to_faces = zeros(registration.gradient_shape(faces, faces_too), faces.device)
    results = {"to_attributes": to_attributes, "to_faces": to_faces}
    fields = _fields(*inputs) | {"grad": grad, "faces_too": faces_too} | results
    if in_any_order(faces.device):
        tasks, run = run_tasks(batch * height, width)
        launch(_attributes_of_run_backward, tasks, [_InterpolateBackward(run=run, **fields)], faces.device)
    else:
        # One task sums the gradient to shared attributes, image by image.
        tasks, least = min(len(attributes), batch) * count, face_tasks(faces, height * width)
        call = _InterpolateBackward(visible=visible_faces(face_index, count), **fields)
        launch(_attributes_of_face_backward, tasks, [call], faces.device, least)
    return to_attributes, to_faces


@registration.forward_operator(1, interpolate)
def interpolate_forward(motion: Tensor, *inputs: Any) -> Tensor:
    """Compute the tangent [T, B, H, W, C] of `interpolate` for tangents of the corners, [T, B, F, 3, 3] float32."""
    attributes, faces, face_index, *_ = inputs
    change = empty((len(motion), *face_index.shape, attributes.shape[3]), faces.device)
    tasks, moved = motion_of(motion, face_index)
    call = _InterpolateForward(forward=_Interpolate(**_fields(*inputs)), motion=moved, change=change)
    least = worth_a_thread(moved.each * face_index.shape[2] * len(motion))
    launch(_interpolate_pixels_forward, tasks, [call], faces.device, least)
    return change


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    to_attributes, to_faces = interpolate_backward(grad, ctx.needs_input_grad[1], *registration.saved_inputs(ctx))
    return {"attributes": to_attributes, "faces": to_faces}


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    attributes, *options = inputs
    to_attributes, motion = tangents[:2]
    parts = []
    if to_attributes is not None:
        parts.append(interpolate(to_attributes, *options))
    if motion is not None:
        parts.append(registration.in_direction(interpolate_forward, (motion,), attributes, *options))
    return registration.sum_of(parts)


registration.differentiable(interpolate, _to_inputs, registration.save_inputs, _forward)


def _to_gradient(ctx: Any, attributes: Tensor, _: Tensor) -> Any:
    # The gradient to attributes is the transpose of the interpolation, so its own gradient interpolates.
    if ctx.needs_input_grad[3]:
        registration.refuse_second("interpolate_backward")
    return {"grad": interpolate(attributes, *registration.saved_inputs(ctx)[3:])}


registration.differentiable(interpolate_backward, _to_gradient, registration.save_inputs)
