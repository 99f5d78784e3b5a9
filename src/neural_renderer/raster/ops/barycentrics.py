"""Barycentric weights and depth of the visible point of each pixel: the differentiable half of rasterisation."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch, module_for_cuda
from ..warp.layout import face_tasks, in_any_order, pixel_tasks, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.point import over_face, over_rows
from ..warp.registration import differentiable, differentiable_once, operator
from .visible_faces import box_of_face, end_of_run, pixels_of_run, visible_faces

# Without fused multiply-adds, weights by edge functions are the values that `coverage` computes.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@operator
def barycentrics(
    faces: Tensor, face_index: Tensor, near: float, far: float, perspective: bool
) -> tuple[Tensor, Tensor]:
    """Compute barycentric weights and depth at each pixel; differentiable in the corners.

    With screen-space weights w_k, depth is ``z = 1 / sum(w_k / z_k)`` and the weights in space are ``w_k z / z_k``. In
    orthographic projection, depth is ``sum(w_k z_k)`` and the weights are w_k. The backward pass is the analytic
    derivative inside the face: at a fixed pixel, moving corner m by v on the screen changes w_k by
    ``-w_m grad(w_k) . v``. A `degenerate` face has no gradient to x and y.

    Args:
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32, as from `coverage`.
        near: As in `coverage`.
        far: As in `coverage`.
        perspective: Whether the projection is perspective; else orthographic.

    Returns:
        Weights in space, [B, H, W, 3] float32 in [0, 1], which interpolate values at the corners. Their sum is 1, or 0
        where no face is visible. Depth, [B, H, W] float32 in [near, far]; ``far`` where no face is visible. Both are
        finite for every face that `coverage` draws.
    """
    batch, height, width = face_index.shape
    weights = empty((batch, height, width, 3), faces.device)
    depth = empty((batch, height, width), faces.device)
    tasks, each = pixel_tasks(batch * height, width, faces.device)
    arguments = [array(faces, wp.vec3), array(face_index), near, far, int(perspective), each]
    launch(
        _forward, tasks, [*arguments, array(weights, wp.vec3), array(depth)], faces.device, worth_a_thread(each * width)
    )
    return weights, depth


@torch.library.register_fake("neural_renderer::barycentrics")
def _(faces, face_index, near, far, perspective):
    shape = face_index.shape
    return faces.new_empty((*shape, 3)), faces.new_empty(shape)


@differentiable_once
def barycentrics_backward(
    grad_weights: Tensor,
    grad_depth: Tensor,
    faces: Tensor,
    face_index: Tensor,
    perspective: bool,
) -> Tensor:
    """Compute the gradient of `barycentrics` to the corners, [B, F, 3, 3] float32."""
    batch, height, width = face_index.shape
    result = zeros(faces.shape, faces.device)
    maps = [array(face_index), array(grad_weights, wp.vec3), array(grad_depth)]
    arguments = [array(faces, wp.vec3), *maps, int(perspective), array(result, wp.vec3)]
    if in_any_order(faces.device):
        tasks, run = run_tasks(batch * height, width)
        launch(_backward_runs, tasks, [*arguments, run], faces.device)
    else:
        arguments.append(array(visible_faces(face_index, faces.shape[1])))
        launch(_backward, batch * faces.shape[1], arguments, faces.device, face_tasks(faces, height * width))
    return result


@torch.library.register_fake("neural_renderer::barycentrics_backward")
def _(grad_weights, grad_depth, faces, face_index, perspective):
    return faces.new_empty(faces.shape)


def _save(ctx, inputs, output):
    faces, face_index, _, _, ctx.perspective = inputs
    ctx.save_for_backward(faces, face_index)


def _to_corners(ctx, grad_weights, grad_depth):
    grad = barycentrics_backward(grad_weights, grad_depth, *ctx.saved_tensors, ctx.perspective)
    return grad, None, None, None, None


differentiable(barycentrics, _to_corners, _save)


_ROWS = over_rows(
    shown="""
            weights_at.data[pixel] = weights;
            depth.data[pixel] = z < near ? near : z > far ? far : z;  // only rounding leaves the range
    """,
    run="""
            const Eight::floats z = eight.z < near ? near : eight.z > far ? far : eight.z;
            if (i + 8 <= width) {
                Eight::store((float*)(weights_at.data + pixel), eight.weights[0], eight.weights[1], eight.weights[2]);
                memcpy(depth.data + pixel, &z, sizeof(z));
            } else for (int n = 0; n < run; ++n) {
                const auto* w = eight.weights;
                weights_at.data[pixel + n] = wp::vec_t<3, float>(w[0][n], w[1][n], w[2][n]);
                depth.data[pixel + n] = z[n];
            }
    """,
    empty="""
                for (int n = 0; n < empty; ++n) depth.data[pixel + n] = far;
                memset(weights_at.data + pixel, 0, empty * sizeof(wp::vec_t<3, float>));
    """,
)


@wp.func_native(_ROWS)
def weigh_rows(
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    near: float,
    far: float,
    perspective: int,
    weights_at: wp.array3d(dtype=wp.vec3),
    depth: wp.array3d(dtype=float),
    task: int,
    each: int,
):
    """Compute the pixels of a task."""
    ...


@wp.kernel
def _forward(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    near: float,
    far: float,
    perspective: int,
    each: int,
    weights: wp.array3d(dtype=wp.vec3),
    depth: wp.array3d(dtype=float),
):
    weigh_rows(faces, face_index, near, far, perspective, weights, depth, first + wp.tid(), each)


_PULL = over_face(
    one="face.pull(grad_weights.data[row + i], grad_depth.data[row + i], weights, on_screen, whole, z);",
    eight="""
                const float* g = (const float*)(grad_weights.data + row + at);
                Eight::floats to_weights[3], to_depth;
                memcpy(&to_depth, grad_depth.data + row + at, sizeof(to_depth));
                Eight::load(g, to_weights);
                for (int k = 0; k < 3; ++k) to_weights[k] = here ? to_weights[k] : Eight::none();
                eight.pull(face, to_weights, here ? to_depth : Eight::none(), here);
    """,
)


@wp.func_native(_PULL)
def pull_face(
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    grad_weights: wp.array3d(dtype=wp.vec3),
    grad_depth: wp.array3d(dtype=float),
    perspective: int,
    b: int,
    f: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
    alone: int,
    faces_too: int,
    to_faces: wp.array3d(dtype=wp.vec3),
):
    """Sum the gradients of a face's pixels in a box; ``alone`` if no other task writes to the same places."""
    ...


@wp.kernel
def _backward(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    grad_weights: wp.array3d(dtype=wp.vec3),
    grad_depth: wp.array3d(dtype=float),
    perspective: int,
    result: wp.array3d(dtype=wp.vec3),
    visible: wp.array2d(dtype=int),
):
    """Visit the pixels that show one face of one image."""
    task = first + wp.tid()
    b = task // faces.shape[1]
    f = task % faces.shape[1]
    if visible[b, f] == 0:
        return
    box = box_of_face(faces, face_index, b, f, perspective)
    if box[0] <= box[1]:
        pull_face(
            faces, face_index, grad_weights, grad_depth, perspective, b, f, box[0], box[1], box[2], box[3], 1, 1, result
        )


@wp.kernel(module=module_for_cuda(__name__))
def _backward_runs(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    grad_weights: wp.array3d(dtype=wp.vec3),
    grad_depth: wp.array3d(dtype=float),
    perspective: int,
    result: wp.array3d(dtype=wp.vec3),
    run: int,
):
    """Add the gradients of a few neighbouring pixels, face by face, on CUDA."""
    task = first + wp.tid()
    row, i, end = pixels_of_run(face_index, task, run)
    height = int(face_index.shape[1])
    b = row // height
    j = height - 1 - row % height
    while i < end:
        f = face_index[b, row % height, i]
        stop = end_of_run(face_index, wp.int64(row), i, end)
        if f >= 0:
            pull_face(faces, face_index, grad_weights, grad_depth, perspective, b, f, i, stop - 1, j, j, 0, 1, result)
        i = stop
