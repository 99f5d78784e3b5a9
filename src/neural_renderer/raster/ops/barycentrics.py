"""Barycentric weights and depth of the visible point of each pixel: the differentiable half of rasterisation."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from ..warp import registration
from ..warp.launch import launch, launch_pixels
from ..warp.layout import face_tasks, in_any_order, pixel_tasks, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from .visible_faces import scene_of, visible_faces

# Without fused multiply-adds, weights by edge functions are the values that `coverage` computes.
_KERNELS = Kernels(__name__, "barycentrics.h", fused=False)
_Weigh, _BarycentricsBackward = _KERNELS.struct("Weigh"), _KERNELS.struct("BarycentricsBackward")
_FORWARD = Kernels(__name__ + ".forward", "barycentrics.h", fused=False)
_Motion, _WeighForward = _FORWARD.struct("Motion"), _FORWARD.struct("WeighForward")
_weigh_pixels = _KERNELS.kernel("weigh_pixels", _Weigh)
_weights_of_face_backward = _KERNELS.kernel("weights_of_face_backward", _BarycentricsBackward)
_weights_of_run_backward = _KERNELS.kernel("weights_of_run_backward", _BarycentricsBackward, only_cuda=True)
_weights_of_pixels_forward = _FORWARD.kernel("weights_of_pixels_forward", _WeighForward)


@registration.operator
def barycentrics(
    faces: Tensor, face_index: Tensor, near: float, far: float, perspective: bool, below: int = 0, above: int = 0
) -> tuple[Tensor, Tensor]:
    """Compute barycentric weights and depth at each pixel; differentiable in the corners.

    With screen-space weights w_k, depth is ``z = 1 / sum(w_k / z_k)`` and the weights in space are ``w_k z / z_k``. In
    orthographic projection, depth is ``sum(w_k z_k)`` and the weights are w_k. The backward pass is the analytic
    derivative inside the face: at a fixed pixel, moving corner m by v on the screen changes w_k by ``-w_m grad(w_k) .
    v``. A `degenerate` face has no gradient to x and y.

    Args:
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32, as from `coverage`.
        near, far, perspective, below, above: As in `coverage`.

    Returns:
        Perspective-correct weights of the corners, [B, H, W, 3] float32 in [0, 1]. Their sum is 1, or 0
        where no face is visible. Depth, [B, H, W] float32 in [near, far]; ``far`` where no face is visible. Both are
        finite for every face that `coverage` draws.
    """
    batch, height, width = face_index.shape
    weights = empty((batch, height, width, 3), faces.device)
    depth = empty((batch, height, width), faces.device)
    fields = {"near": near, "far": far, "weights": weights, "depth": depth}
    scene = scene_of(faces, face_index, perspective, below, above)
    launch_pixels(_weigh_pixels, _Weigh, batch * height, width, faces.device, scene=scene, **fields)
    return weights, depth


@registration.fake(barycentrics)
def _(faces: Tensor, face_index: Tensor) -> tuple[Tensor, Tensor]:
    shape = face_index.shape
    return faces.new_empty((*shape, 3)), faces.new_empty(shape)


@registration.gradient_of(barycentrics, "faces", once=True)
def barycentrics_backward(grad_weights: Tensor | None, grad_depth: Tensor | None, *inputs: Any) -> Tensor:
    """Compute the gradient of `barycentrics` to the corners, [B, F, 3, 3] float32; None stands for zeros."""
    faces, face_index, _, _, *view = inputs
    batch, height, width = face_index.shape
    result = zeros(faces.shape, faces.device)
    maps = {"grad_weights": grad_weights, "grad_depth": grad_depth, "to_faces": result}
    scene = scene_of(faces, face_index, *view)
    if in_any_order(faces.device):
        tasks, run = run_tasks(batch * height, width)
        launch(_weights_of_run_backward, tasks, [_BarycentricsBackward(scene=scene, run=run, **maps)], faces.device)
    else:
        visible = visible_faces(face_index, faces.shape[1])
        least = face_tasks(faces, height * width)
        call = _BarycentricsBackward(scene=scene, visible=visible, **maps)
        launch(_weights_of_face_backward, batch * faces.shape[1], [call], faces.device, least)
    return result


@registration.forward_operator(1, barycentrics)
def barycentrics_forward(motion: Tensor, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute tangents of weights and depth, [T, ...], for tangents of the corners, [T, B, F, 3, 3] float32."""
    faces, face_index, _, _, *view = inputs
    batch, height, width = face_index.shape
    shape = (len(motion), batch, height, width)
    weights, depth = empty((*shape, 3), faces.device), empty(shape, faces.device)
    tasks, moved = motion_of(motion, face_index)
    scene = scene_of(faces, face_index, *view)
    call = _WeighForward(scene=scene, motion=moved, weights=weights, depth=depth)
    launch(_weights_of_pixels_forward, tasks, [call], faces.device, worth_a_thread(moved.each * width * len(motion)))
    return weights, depth


def motion_of(motion: Tensor, face_index: Tensor) -> tuple[int, Call]:
    """Return the number of tasks for rows of pixels, and the `Motion` of kernels, for tangents [T, B, F, 3, 3]."""
    batch, height, width = face_index.shape
    tasks, each = pixel_tasks(batch * height, width, motion.device)
    return tasks, _Motion(corners=motion, directions=len(motion), each=each)


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    registration.save_inputs(ctx, inputs, output)
    ctx.set_materialize_grads(False)


def _to_corners(ctx: Any, *grads: Tensor | None) -> Any:
    return {"faces": barycentrics_backward(*grads, *registration.saved_inputs(ctx))}


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    return registration.in_direction(barycentrics_forward, tangents[:1], *inputs)


registration.differentiable(barycentrics, _to_corners, _save, _forward)
