"""Corners of faces on the screen: `pinhole` and `gather_corners` as one operator.

A small scene spends more time in each call of an operator than in its loops. On CUDA a thread projects the corners of a
face itself, vertices of several faces several times: a launch costs more.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch, module_for_cuda
from ..warp.layout import concurrent, images_of, in_any_order
from ..warp.memory import empty, zeros
from ..warp.registration import differentiable, differentiable_once, operator
from .corners import CORNER, FACE, gather_corners, gather_corners_backward
from .pinhole import CAMERA, POINT, TO_POINT, parts_of_camera, pinhole, pinhole_backward, save_projection

# Without fused multiply-adds, positions are bitwise those of `pinhole`.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@operator
def project_corners(
    vertices: Tensor,
    faces: Tensor,
    rotation: Tensor,
    origin: Tensor,
    width: Tensor,
    aspect: float,
    perspective: bool,
) -> Tensor:
    """Project vertices, and gather the corners of faces; differentiable in all floating tensors.

    Args:
        vertices: [1 or B, V, 3] float32, in the world.
        faces: Vertex indices, [1 or B, F, 3] int32, as of `gather_corners`.
        rotation, origin, width, aspect, perspective: As of `pinhole`.

    Returns:
        [B, F, 3, 3] float32: x, y on the screen, and the depth, of each corner; NaN for an index outside [0, V).
    """
    if not concurrent(vertices.device):
        return gather_corners(pinhole(vertices, rotation, origin, width, aspect, perspective), faces)
    batch = images_of(vertices, rotation, origin, width)
    corners = empty((batch, *faces.shape[1:], 3), vertices.device)
    camera = [array(rotation), array(origin), array(width), aspect, int(perspective)]
    arguments = [array(vertices), array(faces), *camera, array(corners)]
    launch(_forward, batch * faces.shape[1], arguments, vertices.device)
    return corners


@torch.library.register_fake("neural_renderer::project_corners")
def _(vertices, faces, rotation, origin, width, aspect, perspective):
    return vertices.new_empty((images_of(vertices, rotation, origin, width), *faces.shape[1:], 3))


@differentiable_once
def project_corners_backward(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    rotation: Tensor,
    origin: Tensor,
    width: Tensor,
    aspect: float,
    perspective: bool,
    camera_too: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `project_corners`; results as of `pinhole_backward`."""
    if camera_too or not in_any_order(grad.device):
        to_screen = gather_corners_backward(grad, faces, vertices.shape[1])
        return pinhole_backward(to_screen, vertices, rotation, origin, width, aspect, perspective, camera_too)
    to_vertices = zeros(vertices.shape, grad.device)
    camera = [array(rotation), array(origin), array(width), aspect, int(perspective)]
    arguments = [array(vertices), array(faces), *camera, array(grad), array(to_vertices)]
    launch(_backward, len(grad) * faces.shape[1], arguments, grad.device)
    return to_vertices, grad.new_empty((0, 13))


@torch.library.register_fake("neural_renderer::project_corners_backward")
def _(grad, vertices, faces, rotation, origin, width, aspect, perspective, camera_too):
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if camera_too else 0, 13))


def _to_inputs(ctx, grad):
    vertices, faces, *camera = ctx.saved_tensors
    needed = ctx.needs_input_grad[2:5]
    to_vertices, to_camera = project_corners_backward(
        grad, vertices, faces, *camera, ctx.aspect, ctx.perspective, any(needed)
    )
    return to_vertices, None, *parts_of_camera(to_camera, camera, needed), None, None


differentiable(project_corners, _to_inputs, save_projection)


# `corner` is the first of its numbers in [B, F, 3, 3].
_EACH_CORNER = f"""
    {CAMERA}
    {FACE}
    for (int k = 0; k < 3; ++k) {{
        {CORNER}
        const wp::int64 corner = ((b * (wp::int64)faces.shape[1] + f) * 3 + k) * 3;
        DO
    }}
"""


@wp.func_native(
    _EACH_CORNER.replace(
        "DO",
        f"""
        if (!valid) {{ for (int c = 0; c < 3; ++c) corners.data[corner + c] = NAN; continue; }}
        {POINT}
        corners.data[corner] = sx, corners.data[corner + 1] = sy, corners.data[corner + 2] = z;
        """,
    )
)
def project_face(
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    b: int,
    f: int,
    corners: wp.array4d(dtype=float),
):
    """Project the corners of a face in image b."""
    ...


@wp.func_native(
    _EACH_CORNER.replace(
        "DO",
        f"""
        if (!valid) continue;
        {POINT}
        const float* g = grad.data + corner;
        {TO_POINT}
        float* to = to_vertices.data + (b < vertices.shape[0] ? b : vertices.shape[0] - 1) * (wp::int64)count * 3;
        wp::atomic_add(to + 3 * i, to_dx);
        wp::atomic_add(to + 3 * i + 1, to_dy);
        wp::atomic_add(to + 3 * i + 2, to_dz);
        """,
    )
)
def unproject_face(
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    b: int,
    f: int,
    grad: wp.array4d(dtype=float),
    to_vertices: wp.array3d(dtype=float),
):
    """Add the gradient of the corners of a face in image b to the vertices."""
    ...


@wp.kernel(module=module_for_cuda(__name__))
def _forward(
    first: int,
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    corners: wp.array4d(dtype=float),
):
    task = first + wp.tid()
    count = faces.shape[1]
    project_face(vertices, faces, rotation, origin, width, aspect, perspective, task // count, task % count, corners)


@wp.kernel(module=module_for_cuda(__name__))
def _backward(
    first: int,
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    rotation: wp.array3d(dtype=float),
    origin: wp.array2d(dtype=float),
    width: wp.array1d(dtype=float),
    aspect: float,
    perspective: int,
    grad: wp.array4d(dtype=float),
    to_vertices: wp.array3d(dtype=float),
):
    task = first + wp.tid()
    count = faces.shape[1]
    unproject_face(
        vertices, faces, rotation, origin, width, aspect, perspective, task // count, task % count, grad, to_vertices
    )
