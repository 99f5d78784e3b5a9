"""Corners of faces on the screen: `pinhole` and `gather_corners` as one operator.

A small scene spends more time in each call of an operator than in its loops. On CUDA a thread projects the corners of a
face itself, vertices of several faces several times: a launch costs more.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any, Optional

import torch
from torch import Tensor

from ..warp import registration
from ..warp.launch import launch
from ..warp.layout import concurrent, images_of, in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from .corners import gather_corners, gather_corners_backward, triangles_of
from .pinhole import CAMERA_SUMS, LEAST_DEPTH, parts_of_camera, pinhole, pinhole_backward, view_of

# Without fused multiply-adds, positions are bitwise those of `pinhole`.
_KERNELS = Kernels(__name__, "pinhole.h", fused=False)
_ProjectCorners = _KERNELS.struct("ProjectCorners")
_project_corners = _KERNELS.kernel("project_corners", _ProjectCorners, only_cuda=True)
_project_corners_backward = _KERNELS.kernel("project_corners_backward", _ProjectCorners, only_cuda=True)


@registration.operator
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

    Faces are vertex indices [1 or B, F, 3] int32 as of `gather_corners`; other arguments are as of `pinhole`. Returns
    [B, F, 3, 3] float32: x, y on the screen, and the depth, of each corner; NaN for an index outside [0, V).
    """
    if not concurrent(vertices.device):
        return gather_corners(pinhole(vertices, rotation, origin, width, aspect, perspective), faces)
    batch = images_of(vertices, rotation, origin, width)
    corners = empty((batch, *faces.shape[1:], 3), vertices.device)
    view = view_of(vertices, rotation, origin, width, aspect, perspective)
    call = _ProjectCorners(view=view, triangles=triangles_of(faces, vertices.shape[1]), corners=corners)
    launch(_project_corners, batch * faces.shape[1], [call], vertices.device)
    return corners


@registration.fake(project_corners)
def _(vertices: Tensor, faces: Tensor, rotation: Tensor, origin: Tensor, width: Tensor) -> Tensor:
    return vertices.new_empty((images_of(vertices, rotation, origin, width), *faces.shape[1:], 3))


@registration.gradient_of(project_corners, once=True)
def project_corners_backward(grad: Tensor, camera_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `project_corners`; results as of `pinhole_backward`."""
    vertices, faces, *view = inputs
    if camera_too or not in_any_order(grad.device):
        to_screen = gather_corners_backward(grad, faces, vertices.shape[1])
        return pinhole_backward(to_screen, camera_too, vertices, *view)
    to_vertices = zeros(vertices.shape, grad.device)
    call = _ProjectCorners(
        view=view_of(vertices, *view),
        triangles=triangles_of(faces, vertices.shape[1]),
        corners=grad.contiguous(),
        to_vertices=to_vertices,
    )
    launch(_project_corners_backward, len(grad) * faces.shape[1], [call], grad.device)
    return to_vertices, grad.new_empty((0, CAMERA_SUMS))


@registration.fake(project_corners_backward)
def _(grad: Tensor, vertices: Tensor, camera_too: bool) -> tuple[Tensor, Tensor]:
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if camera_too else 0, CAMERA_SUMS))


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    inputs, camera_too = registration.kept_inputs(ctx), any(ctx.needs_input_grad[2:5])
    to_vertices, to_camera = project_corners_backward(grad, camera_too, *inputs)
    return {"vertices": to_vertices} | (parts_of_camera(to_camera, inputs[2:5]) if camera_too else {})


@registration.forward_operator(4, project_corners)
def project_corners_forward(
    to_vertices: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    to_rotation: Optional[Tensor],  # noqa: UP045
    to_origin: Optional[Tensor],  # noqa: UP045
    to_width: Optional[Tensor],  # noqa: UP045
    *inputs: Any,
) -> Tensor:
    """Compute the change [T, B, F, 3, 3] of `project_corners` for changes of its inputs, [T, ...] or None for 0."""
    vertices, faces, rotation, origin, width, aspect, perspective = inputs
    batch = images_of(vertices, rotation, origin, width)
    arm, width = vertices - origin[:, None], width[:, None, None]
    by_arm = [part for part in (to_vertices, None if to_origin is None else -to_origin[:, :, None]) if part is not None]
    parts = [rotate(rotation, part) for part in by_arm]
    if to_rotation is not None:
        parts.append(rotate(to_rotation, arm))
    place = rotate(rotation, arm)
    change = registration.sum_of(parts)
    if change is None:
        change = place.new_zeros(1, 1, 1, 3)
    screen, by_depth = place[..., :2], change[..., 2:]
    to_screen = change[..., :2]
    if perspective:
        depth = place[..., 2:]
        beside = depth.abs() < LEAST_DEPTH
        near = torch.where(beside, torch.where(depth < 0, -LEAST_DEPTH, LEAST_DEPTH), depth)
        screen = screen / near
        to_screen = (to_screen - screen * torch.where(beside, 0.0, by_depth)) / near / width
        screen, by_width = screen / width, -1 / width
    else:
        to_screen, by_width = to_screen * width, torch.ones_like(width)
    if to_width is not None:
        to_screen = to_screen + screen * by_width * to_width[:, :, None, None]
    to_screen = to_screen / to_screen.new_tensor((aspect, 1.0))
    shape = (*torch.broadcast_shapes(to_screen.shape[:2], (1, batch)), vertices.shape[1])
    screen = torch.cat((to_screen.expand(*shape, 2), by_depth.expand(*shape, 1)), -1)
    own = faces if len(faces) == 1 else faces.repeat(len(screen), 1, 1)
    return gather_corners(screen.flatten(0, 1), own).unflatten(0, shape[:2])


def rotate(rotation: Tensor, points: Tensor) -> Tensor:
    """Multiply matrices [..., 3, 3] by points [..., V, 3]; not matmul, which may round coordinates to 10 bits."""
    x, y, z = points.split(1, -1)
    columns = rotation[..., None, :, :]
    return x * columns[..., 0] + y * columns[..., 1] + z * columns[..., 2]


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    to_vertices, _, *to_camera = tangents[:5]
    return registration.in_direction(project_corners_forward, (to_vertices, *to_camera), *inputs)


registration.differentiable(project_corners, _to_inputs, registration.keep_inputs, _forward)
