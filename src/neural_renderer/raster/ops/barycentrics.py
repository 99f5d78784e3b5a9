"""Where on its face each pixel lies, and how deep: the smooth half of rasterisation."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import degenerate, homogeneous_weights, in_front, pixel_box, pixel_centre, to_pixels
from ..warp.launch import array, face_lanes, launch, zeros
from ..warp.registration import differentiable_once, operator
from .visible_faces import next_shown, seen_faces

# Without fused multiply-adds, so that `edge_weights` computes what `coverage` does.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Of the square of a face's largest coordinate c, in pixels: in less area nothing is known of the weights by
# `pixel_matrix`. They are made of products of up to 2 c^2, and all roundings together come to some 82 * 2^-24 c^2.
LEAST_AREA = wp.constant(2.0**-17)


@operator
def barycentrics(
    faces: Tensor, face_index: Tensor, near: float, far: float, perspective: bool
) -> tuple[Tensor, Tensor]:
    """Weights and depth at each pixel of the face that `coverage` found there; differentiable in the corners.

    faces: [B, F, 3, 3] float32 screen-space corners; face_index: [B, H, W] int32.
    near, far: as in `coverage`.
    perspective: depth is ``1 / sum(w_k / z_k)``; ``sum(w_k z_k)`` otherwise.

    Returns weights [B, H, W, 3], the shares of the corners in the point that is seen, in space: what a quantity given
    at the corners is interpolated with: ``w_k z / z_k`` (``w_k`` without perspective), in [0, 1], of sum 1, and 0 where
    no face is seen. And depth [B, H, W] in [near, far], ``far`` where no face is seen. Both are finite for any face
    that `coverage` draws. Backward is the analytic derivative inside the face: with the pixel fixed, moving corner m by
    v on the screen changes w_k by ``-w_m grad(w_k) . v``. A `degenerate` face passes no gradient to x and y.
    """
    batch, height, width = face_index.shape
    weights = torch.empty((batch, height, width, 3), dtype=torch.float32, device=faces.device)
    depth = torch.empty((batch, height, width), dtype=torch.float32, device=faces.device)
    arguments = [array(faces, wp.vec3), array(face_index), near, far, int(perspective)]
    launch(_forward, batch * height, [*arguments, array(weights, wp.vec3), array(depth)], faces.device)
    return weights, depth


@torch.library.register_fake("neural_renderer::barycentrics")
def _(faces, face_index, near, far, perspective):  # type: ignore[no-untyped-def]
    shape = face_index.shape
    return faces.new_empty((*shape, 3)), faces.new_empty(shape)


@differentiable_once
def barycentrics_backward(
    grad_weights: Tensor,
    grad_depth: Tensor,
    faces: Tensor,
    face_index: Tensor,
    weights: Tensor,
    depth: Tensor,
    perspective: bool,
) -> Tensor:
    """The gradient [B, F, 3, 3] of `barycentrics` to the corners."""
    batch, height, width = face_index.shape
    result = zeros(faces.shape, faces.device)
    lanes = face_lanes(faces, height * width)
    maps = [array(face_index), array(weights, wp.vec3), array(depth)]
    grads = [array(grad_weights, wp.vec3), array(grad_depth)]
    seen = array(seen_faces(face_index, faces.shape[1]))
    arguments = [
        array(faces, wp.vec3),
        *maps,
        *grads,
        seen,
        int(perspective),
        lanes,
        array(result, wp.vec3),
    ]
    launch(_backward, batch * faces.shape[1] * lanes, arguments, faces.device)
    return result


@torch.library.register_fake("neural_renderer::barycentrics_backward")
def _(grad_weights, grad_depth, faces, face_index, weights, depth, perspective):  # type: ignore[no-untyped-def]
    return faces.new_empty(faces.shape)


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    faces, face_index, _, _, ctx.perspective = inputs
    ctx.save_for_backward(faces, face_index, *output)


def _to_corners(ctx, grad_weights, grad_depth):  # type: ignore[no-untyped-def]
    faces, face_index, weights, depth = ctx.saved_tensors
    grad = barycentrics_backward(grad_weights, grad_depth, faces, face_index, weights, depth, ctx.perspective)
    return grad, None, None, None, None


torch.library.register_autograd("neural_renderer::barycentrics", _to_corners, setup_context=_save)


@wp.func
def pixel_matrix(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, height: int, width: int) -> wp.mat33:
    """The matrix that takes a pixel (column, row from the bottom, 1) to its weights; 0 if `edge_weights` must do.

    Weights by this inverse are how the first packages computed them: for faces far smaller than a pixel its rounding
    (some 1e-4 of a weight) is what existing results contain.
    """
    x0 = to_pixels(v0[0], width)
    x1 = to_pixels(v1[0], width)
    x2 = to_pixels(v2[0], width)
    y0 = to_pixels(v0[1], height)
    y1 = to_pixels(v1[1], height)
    y2 = to_pixels(v2[1], height)
    area = x2 * (y0 - y1) + x0 * (y1 - y2) + x1 * (y2 - y0)
    x = wp.max(wp.abs(x0), wp.max(wp.abs(x1), wp.abs(x2)))
    y = wp.max(wp.abs(y0), wp.max(wp.abs(y1), wp.abs(y2)))
    if not wp.abs(area) > LEAST_AREA * wp.max(x, y) * wp.max(x, y):
        return wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return wp.mat33(
        (y1 - y2) / area, (x2 - x1) / area, (x1 * y2 - x2 * y1) / area,
        (y2 - y0) / area, (x0 - x2) / area, (x2 * y0 - x0 * y2) / area,
        (y0 - y1) / area, (x1 - x0) / area, (x0 * y1 - x1 * y0) / area,
    )  # fmt: skip


@wp.func
def edge_weights(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float) -> wp.vec3:
    """The weights by the edge functions of `coverage`: where it drew the face, they have one sign and are not all 0."""
    e0 = (v1[0] - x) * (v2[1] - y) - (v1[1] - y) * (v2[0] - x)
    e1 = (v2[0] - x) * (v0[1] - y) - (v2[1] - y) * (v0[0] - x)
    e2 = (v0[0] - x) * (v1[1] - y) - (v0[1] - y) * (v1[0] - x)
    whole = e0 + e1 + e2
    if whole == 0.0:
        return wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
    return wp.vec3(e0 / whole, e1 / whole, e2 / whole)


@wp.kernel
def _forward(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    near: float,
    far: float,
    perspective: int,
    weights: wp.array3d(dtype=wp.vec3),
    depth: wp.array3d(dtype=float),
):
    task = first + wp.tid()
    height = face_index.shape[1]
    width = face_index.shape[2]
    b = task // height
    row = task % height
    y = pixel_centre(height - 1 - row, height)
    last = int(-1)
    front = int(0)
    v0 = wp.vec3(0.0, 0.0, 0.0)
    v1 = wp.vec3(0.0, 0.0, 0.0)
    v2 = wp.vec3(0.0, 0.0, 0.0)
    matrix = wp.mat33()
    for i in range(width):
        f = face_index[b, row, i]
        w = wp.vec3(0.0, 0.0, 0.0)
        z = far
        if f >= 0:
            if f != last:  # neighbours mostly show the same face
                last = f
                v0 = faces[b, f, 0]
                v1 = faces[b, f, 1]
                v2 = faces[b, f, 2]
                front = in_front(v0, v1, v2, perspective)
                matrix = pixel_matrix(v0, v1, v2, height, width)
            if front == 1:
                for k in range(3):
                    share = matrix[k, 0] * float(i) + matrix[k, 1] * float(height - 1 - row) + matrix[k, 2]
                    w[k] = wp.clamp(share, 0.0, 1.0)
                whole = w[0] + w[1] + w[2]
                if whole == 0.0:
                    w = edge_weights(v0, v1, v2, pixel_centre(i, width), y)
                    whole = 1.0
                w = w / whole
                if perspective == 1:
                    z = 1.0 / (w[0] / v0[2] + w[1] / v1[2] + w[2] / v2[2])
                    w = wp.vec3(w[0] * z / v0[2], w[1] * z / v1[2], w[2] * z / v2[2])
                else:
                    z = w[0] * v0[2] + w[1] * v1[2] + w[2] * v2[2]
            else:
                a = homogeneous_weights(v0, v1, v2, pixel_centre(i, width), y)
                inverse = a[0] + a[1] + a[2]
                z = float(wp.float64(1.0) / inverse)
                w = wp.vec3(float(a[0] / inverse), float(a[1] / inverse), float(a[2] / inverse))
            z = wp.clamp(z, near, far)  # where it was drawn, but for the rounding of the weights
        weights[b, row, i] = w
        depth[b, row, i] = z


@wp.kernel
def _backward(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    weights: wp.array3d(dtype=wp.vec3),
    depth: wp.array3d(dtype=float),
    grad_weights: wp.array3d(dtype=wp.vec3),
    grad_depth: wp.array3d(dtype=float),
    seen: wp.array2d(dtype=int),
    perspective: int,
    lanes: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """One face of one image, over the pixels that show it; with several lanes, each takes every n-th row."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    if seen[b, f] == 0:
        return
    height = face_index.shape[1]
    width = face_index.shape[2]
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    front = in_front(v0, v1, v2, perspective)
    if front < 0:
        return
    # What the weights gain per step to the right and up.
    dx = wp.vec3(0.0, 0.0, 0.0)
    dy = wp.vec3(0.0, 0.0, 0.0)
    if not degenerate(v0, v1, v2):
        area = (v1[0] - v0[0]) * (v2[1] - v0[1]) - (v1[1] - v0[1]) * (v2[0] - v0[0])
        dx = wp.vec3(v1[1] - v2[1], v2[1] - v0[1], v0[1] - v1[1]) / area
        dy = wp.vec3(v2[0] - v1[0], v0[0] - v2[0], v1[0] - v0[0]) / area
    z = wp.vec3(v0[2], v1[2], v2[2])
    # In perspective, depth and the weights in space are made of w_k / z_k: 1 / depth is their sum.
    inverse = wp.vec3(1.0, 1.0, 1.0)
    if perspective == 1:
        inverse = wp.vec3(1.0 / z[0], 1.0 / z[1], 1.0 / z[2])
    to_x = wp.vec3(0.0, 0.0, 0.0)
    to_y = wp.vec3(0.0, 0.0, 0.0)
    to_z = wp.vec3(0.0, 0.0, 0.0)
    box = pixel_box(v0, v1, v2, front, height, width)
    for j in range(box[2] + lane, box[3] + 1, lanes):
        row = height - 1 - j
        line = wp.int64(b) * wp.int64(height) + wp.int64(row)
        i = next_shown(face_index, line, width, box[0], box[1] + 1, f)
        while i <= box[1]:
            w = weights[b, row, i]
            to_weights = grad_weights[b, row, i]
            to_depth = grad_depth[b, row, i]
            if perspective == 1:
                d = depth[b, row, i]
                same = wp.dot(to_weights, w) + d * to_depth
                g = d * wp.cw_mul(to_weights - wp.vec3(same, same, same), inverse)
                w = wp.vec3(w[0] * z[0], w[1] * z[1], w[2] * z[2]) / d
                to_z -= wp.cw_mul(g, wp.cw_mul(w, inverse))
            else:
                g = to_weights + to_depth * z
                to_z += to_depth * w
            to_x -= wp.dot(g, dx) * w
            to_y -= wp.dot(g, dy) * w
            i = next_shown(face_index, line, width, i + 1, box[1] + 1, f)
    for k in range(3):
        part = wp.vec3(to_x[k], to_y[k], to_z[k])
        if lanes == 1:
            result[b, f, k] = part
        else:
            wp.atomic_add(result, b, f, k, part)
