"""Projection by cameras without distortion, fused; replaces about 30 torch operations of `Camera`."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.layout import concurrent, group_tasks, images_of
from ..warp.memory import empty, zeros
from ..warp.registration import differentiable_once, operator

# Without fused multiply-adds, positions are bitwise those of torch.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NEAREST = 1e-6  # smallest |z| in the division of x and y by z, in world units
_SUMS = 13  # partial sums of each group of vertices: rotation, origin, width


@operator
def pinhole(
    vertices: Tensor, rotation: Tensor, origin: Tensor, width: Tensor, aspect: float, perspective: bool
) -> Tensor:
    """Project vertices. `project_corners`, which calls it, is differentiable.

    Args:
        vertices: [1 or B, V, 3] float32, in the world.
        rotation: The axes of the cameras as rows, [1 or B, 3, 3] float32.
        origin: Their positions, [1 or B, 3] float32.
        width: Tangent of half the field of view, or, without perspective, screen units per world unit, [1 or B].
        aspect: Width / height of the image; x is divided by it.
        perspective: Whether x and y are divided by the depth.

    Returns:
        [B, V, 3] float32: x, y on the screen, and the depth.
    """
    batch, count = images_of(vertices, rotation, origin, width), vertices.shape[1]
    screen = empty((batch, count, 3), vertices.device)
    groups, each = group_tasks(count, vertices.device, 1024)
    arguments = [*_arguments(vertices, rotation, origin, width, aspect, perspective), groups, each, array(screen)]
    launch(_forward, batch * groups, arguments, vertices.device, _LEAST)
    return screen


@torch.library.register_fake("neural_renderer::pinhole")
def _(vertices, rotation, origin, width, aspect, perspective):
    return vertices.new_empty((images_of(vertices, rotation, origin, width), vertices.shape[1], 3))


@differentiable_once
def pinhole_backward(
    grad: Tensor,
    vertices: Tensor,
    rotation: Tensor,
    origin: Tensor,
    width: Tensor,
    aspect: float,
    perspective: bool,
    camera_too: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `pinhole`.

    Returns:
        To the vertices, [1 or B, V, 3]; to the cameras, [B, 13]: rotation, origin, width; empty if not ``camera_too``.
    """
    batch, count = grad.shape[:2]
    if batch == 0:
        return zeros(vertices.shape, grad.device), grad.new_zeros((0, _SUMS))
    groups, each = group_tasks(count, grad.device, 1024, 32)
    # On the CPU, one task sums the gradient to vertices that images share, image by image.
    own = batch if concurrent(grad.device) else len(vertices)
    to_vertices = empty((own, count, 3), grad.device)
    sums = torch.empty((batch, groups, _SUMS) if camera_too else (0, 0, _SUMS), device=grad.device)
    arguments = [*_arguments(vertices, rotation, origin, width, aspect, perspective), groups, each, array(grad)]
    arguments += [int(camera_too), array(to_vertices), array(sums)]
    launch(_backward, own * groups, arguments, grad.device, max(1, _LEAST * own // max(batch, 1)))
    if own > len(vertices):
        to_vertices = to_vertices.sum(0, keepdim=True)
    return to_vertices, sums.sum(1)


@torch.library.register_fake("neural_renderer::pinhole_backward")
def _(grad, vertices, rotation, origin, width, aspect, perspective, camera_too):
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if camera_too else 0, _SUMS))


# Groups of vertices that are worth another thread.
_LEAST = 8


def _arguments(vertices, rotation, origin, width, aspect, perspective):
    return [array(vertices), array(rotation), array(origin), array(width), aspect, int(perspective)]


def save_projection(ctx, inputs, output):
    """Keep the inputs of a projection for its gradient: tensors, then aspect and perspective."""
    *tensors, ctx.aspect, ctx.perspective = inputs
    ctx.save_for_backward(*tensors)


def parts_of_camera(gradient, camera, needed):
    """Split a gradient [B, 13] from `pinhole_backward` into those of the rotation, origin and width that are needed."""
    return [
        (own if len(tensor) == len(own) else own.sum(0)).reshape(tensor.shape) if needs else None
        for tensor, own, needs in zip(camera, gradient.split((9, 3, 1), 1), needed, strict=True)
    ]


CAMERA = """
    const int count = vertices.shape[1];
    const float* r = rotation.data + (b < rotation.shape[0] ? b : rotation.shape[0] - 1) * (wp::int64)9;
    const float* o = origin.data + (b < origin.shape[0] ? b : origin.shape[0] - 1) * (wp::int64)3;
    const float* v = vertices.data + (b < vertices.shape[0] ? b : vertices.shape[0] - 1) * (wp::int64)count * 3;
    const float across = width.data[b < width.shape[0] ? b : width.shape[0] - 1];
"""
POINT = f"""
        const float dx = v[3 * i] - o[0], dy = v[3 * i + 1] - o[1], dz = v[3 * i + 2] - o[2];
        const float x = dx * r[0] + dy * r[1] + dz * r[2];
        const float y = dx * r[3] + dy * r[4] + dz * r[5];
        const float z = dx * r[6] + dy * r[7] + dz * r[8];
        const bool beside = fabsf(z) < {NEAREST!r}f;  // of the camera's plane
        const float near = beside ? (z < 0.0f ? -{NEAREST!r}f : {NEAREST!r}f) : z;
        const float sx = (perspective ? x / near / across : x * across) / aspect;
        const float sy = perspective ? y / near / across : y * across;
"""
# The gradient to the point, from the gradient g to its position on the screen.
TO_POINT = """
        const float gx = g[0], gy = g[1], along = gx * sx + gy * sy;
        const float to_x = (perspective ? gx / near / across : gx * across) / aspect;
        const float to_y = perspective ? gy / near / across : gy * across;
        const float to_z = g[2] - (perspective && !beside ? along / near : 0.0f);
        const float to_dx = to_x * r[0] + to_y * r[3] + to_z * r[6];
        const float to_dy = to_x * r[1] + to_y * r[4] + to_z * r[7];
        const float to_dz = to_x * r[2] + to_y * r[5] + to_z * r[8];
"""


@wp.func_native(f"""
    {CAMERA}
    float* to = screen.data + b * (wp::int64)count * 3;
    for (int i = begin; i < end; ++i) {{
        {POINT}
        to[3 * i] = sx, to[3 * i + 1] = sy, to[3 * i + 2] = z;
    }}
""")
def project_points(
    vertices: wp.array3d(dtype=float),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    b: int,
    begin: int,
    end: int,
    screen: wp.array3d(dtype=float),
):
    """Project the vertices [begin, end) in image b."""


@wp.func_native(f"""
    {CAMERA}
    const float* all = grad.data + b * (wp::int64)count * 3;
    float* to = to_vertices.data + own * (wp::int64)count * 3;
    double sum[13];
    for (int k = 0; k < 13; ++k) sum[k] = 0.0;
    for (int i = begin; i < end; ++i) {{
        {POINT}
        const float* g = all + 3 * i;
        {TO_POINT}
        if (add) to[3 * i] += to_dx, to[3 * i + 1] += to_dy, to[3 * i + 2] += to_dz;
        else to[3 * i] = to_dx, to[3 * i + 1] = to_dy, to[3 * i + 2] = to_dz;
        if (!camera_too) continue;
        sum[0] += to_x * dx, sum[1] += to_x * dy, sum[2] += to_x * dz;
        sum[3] += to_y * dx, sum[4] += to_y * dy, sum[5] += to_y * dz;
        sum[6] += to_z * dx, sum[7] += to_z * dy, sum[8] += to_z * dz;
        sum[9] -= to_dx, sum[10] -= to_dy, sum[11] -= to_dz;
        sum[12] += perspective ? -along / across : gx * x / aspect + gy * y;
    }}
    float* whole = sums.data + (b * (wp::int64)sums.shape[1] + group) * 13;
    for (int k = 0; k < 13 && camera_too; ++k) whole[k] = (float)sum[k];
""")
def unproject_points(
    vertices: wp.array3d(dtype=float),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    b: int,
    own: int,
    add: int,
    group: int,
    begin: int,
    end: int,
    grad: wp.array3d(dtype=float),
    camera_too: int,
    to_vertices: wp.array3d(dtype=float),
    sums: wp.array3d(dtype=float),
):
    """Compute the gradients of the vertices [begin, end) in image b, accumulated into mesh ``own`` if ``add``."""


@wp.kernel
def _forward(
    first: int,
    vertices: wp.array3d(dtype=float),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    groups: int,
    each: int,
    screen: wp.array3d(dtype=float),
):
    task = first + wp.tid()
    begin = (task % groups) * each
    end = wp.min(begin + each, vertices.shape[1])
    project_points(vertices, rotation, origin, width, aspect, perspective, task // groups, begin, end, screen)


@wp.kernel
def _backward(
    first: int,
    vertices: wp.array3d(dtype=float),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    groups: int,
    each: int,
    grad: wp.array3d(dtype=float),
    camera_too: int,
    to_vertices: wp.array3d(dtype=float),
    sums: wp.array3d(dtype=float),
):
    task = first + wp.tid()
    group = task % groups
    own = task // groups
    begin = group * each
    end = wp.min(begin + each, vertices.shape[1])
    from_image = own
    to_image = own + 1
    if to_vertices.shape[0] < grad.shape[0]:
        from_image = 0
        to_image = grad.shape[0]
    for b in range(from_image, to_image):
        add = int(b > from_image)
        unproject_points(
            vertices, rotation, origin, width, aspect, perspective, b, own, add, group, begin, end, grad, camera_too,
            to_vertices, sums,
        )  # fmt: skip
