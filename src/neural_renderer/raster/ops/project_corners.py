"""Corners of faces on the screen, by cameras without distortion: projection and `gather_corners` as one operator.

It replaces about 30 torch operations of `Camera`. A small scene spends more time in each call of an operator than in
its loops. On CUDA a thread projects the corners of a face itself, and so a shared vertex several times, because another
launch would cost more.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any, Optional

import torch
from torch import Tensor

from ..warp import registration
from ..warp.launch import launch
from ..warp.layout import concurrent, group_tasks, images_of, in_any_order
from ..warp.memory import contiguous, empty, zeros
from ..warp.native import Call, Kernels, constant
from .corners import Groups, gather_corners, gather_corners_backward, triangles_of

# Without fused multiply-adds, positions are bitwise those of torch.
_KERNELS = Kernels(__name__, "pinhole.h", fused=False)
_View, _ProjectCorners = _KERNELS.struct("View"), _KERNELS.struct("ProjectCorners")
_Project, _ProjectBackward = _KERNELS.struct("Project"), _KERNELS.struct("ProjectBackward")
_project_vertices = _KERNELS.kernel("project_vertices", _Project)
_project_vertices_backward = _KERNELS.kernel("project_vertices_backward", _ProjectBackward)
_project_corners = _KERNELS.kernel("project_corners", _ProjectCorners, only_cuda=True)
_project_corners_backward = _KERNELS.kernel("project_corners_backward", _ProjectCorners, only_cuda=True)

LEAST_DEPTH = constant("pinhole.h", "LEAST_DEPTH", float)
_CAMERA_SUMS = constant("pinhole.h", "CAMERA_SUMS")
_LEAST = 8  # groups of vertices that justify another thread


@registration.operator
def project_corners(
    vertices: Tensor, faces: Tensor, rotation: Tensor, origin: Tensor, width: Tensor, aspect: float, perspective: bool
) -> Tensor:
    """Project vertices, and gather the corners of faces; differentiable in all floating tensors.

    Args:
        vertices: [1 or B, V, 3] float32, in the world.
        faces: Vertex indices, [1 or B, F, 3] int32, as in `gather_corners`.
        rotation, origin: Axes of the cameras as rows, [1 or B, 3, 3] float32, and their positions, [1 or B, 3].
        width: Tangent of half the field of view, or, without perspective, screen units per world unit, [1 or B].
        aspect: Width / height of the image; x is divided by it.

    Returns:
        [B, F, 3, 3] float32: x, y on the screen, and the depth, by which x and y are divided in perspective; NaN for an
        index outside [0, V).
    """
    camera = (rotation, origin, width, aspect, perspective)
    if not concurrent(vertices.device):
        return gather_corners(_project(vertices, *camera), faces)
    batch = images_of(vertices, rotation, origin, width)
    corners = empty((batch, *faces.shape[1:], 3), vertices.device)
    view = _view(vertices, *camera)
    call = _ProjectCorners(view=view, triangles=triangles_of(faces, vertices.shape[1]), corners=corners)
    launch(_project_corners, batch * faces.shape[1], [call], vertices.device)
    return corners


@registration.fake(project_corners)
def _(vertices: Tensor, faces: Tensor, rotation: Tensor, origin: Tensor, width: Tensor) -> Tensor:
    return vertices.new_empty((images_of(vertices, rotation, origin, width), *faces.shape[1:], 3))


@registration.gradient_of(project_corners, once=True)
def project_corners_backward(grad: Tensor, camera_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `project_corners` to the vertices, [1 or B, V, 3], and to the cameras, [B, 13].

    The latter has rotation, origin and width; it is empty if not ``camera_too``.
    """
    vertices, faces, *camera = inputs
    if camera_too or not in_any_order(grad.device):
        to_screen = gather_corners_backward(grad, faces, vertices.shape[1])
        return _project_backward(to_screen, camera_too, vertices, *camera)
    to_vertices = zeros(vertices.shape, grad.device)
    call = _ProjectCorners(
        view=_view(vertices, *camera),
        triangles=triangles_of(faces, vertices.shape[1]),
        corners=contiguous(grad),
        to_vertices=to_vertices,
    )
    launch(_project_corners_backward, len(grad) * faces.shape[1], [call], grad.device)
    return to_vertices, grad.new_empty((0, _CAMERA_SUMS))


@registration.fake(project_corners_backward)
def _(grad: Tensor, vertices: Tensor, camera_too: bool) -> tuple[Tensor, Tensor]:
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if camera_too else 0, _CAMERA_SUMS))


def _project(vertices: Tensor, rotation: Tensor, origin: Tensor, width: Tensor, *how: Any) -> Tensor:
    """Project vertices: [B, V, 3] float32, as the results of `project_corners`."""
    batch, count = images_of(vertices, rotation, origin, width), vertices.shape[1]
    screen = empty((batch, count, 3), vertices.device)
    groups, each = group_tasks(count, vertices.device, 1024)
    view = _view(vertices, rotation, origin, width, *how)
    call = _Project(view=view, tasks=Groups(groups=groups, each=each), screen=screen)
    launch(_project_vertices, batch * groups, [call], vertices.device, _LEAST)
    return screen


def _project_backward(grad: Tensor, camera_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `_project`; results as of `project_corners_backward`."""
    vertices = inputs[0]
    batch, count = grad.shape[:2]
    if batch == 0:
        return zeros(vertices.shape, grad.device), grad.new_zeros((0, _CAMERA_SUMS))
    groups, each = group_tasks(count, grad.device, 1024, 32)
    # One CPU task sums the gradient to vertices that images share, image by image.
    targets = batch if concurrent(grad.device) else len(vertices)
    to_vertices = empty((targets, count, 3), grad.device)
    sums = empty((batch, groups, _CAMERA_SUMS) if camera_too else (0, _CAMERA_SUMS), grad.device)
    call = _ProjectBackward(
        view=_view(*inputs),
        tasks=Groups(groups=groups, each=each),
        grad=grad,
        images=batch,
        targets=targets,
        to_vertices=to_vertices,
        sums=sums if camera_too else None,
    )
    launch(_project_vertices_backward, targets * groups, [call], grad.device, max(1, _LEAST * targets // max(batch, 1)))
    if targets > len(vertices):
        to_vertices = to_vertices.sum(0, keepdim=True)
    return to_vertices, sums.sum(1) if camera_too else sums


def _view(*inputs: Any) -> Call:
    """Make the `View` of kernels, from the inputs of `_project`."""
    vertices, rotation, origin, width, aspect, perspective = inputs
    return _View(
        vertices=vertices,
        rotation=rotation,
        origin=origin,
        width=width,
        meshes=vertices.shape[0],
        rotations=rotation.shape[0],
        origins=origin.shape[0],
        widths=width.shape[0],
        count=vertices.shape[1],
        aspect=aspect,
        perspective=perspective,
    )


def _parts_of_camera(gradient: Tensor, camera: Sequence[Tensor]) -> dict[str, Tensor]:
    """Split a gradient [B, 13] from `project_corners_backward` into those of rotation, origin and width."""
    parts = zip(("rotation", "origin", "width"), camera, gradient.split((9, 3, 1), 1), strict=True)
    return {
        name: (total if len(given) == len(total) else total.sum(0)).reshape(given.shape) for name, given, total in parts
    }


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    inputs, camera_too = registration.saved_inputs(ctx), any(ctx.needs_input_grad[2:5])
    to_vertices, to_camera = project_corners_backward(grad, camera_too, *inputs)
    return {"vertices": to_vertices} | (_parts_of_camera(to_camera, inputs[2:5]) if camera_too else {})


@registration.forward_operator(4, project_corners)
def project_corners_forward(
    to_vertices: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    to_rotation: Optional[Tensor],  # noqa: UP045
    to_origin: Optional[Tensor],  # noqa: UP045
    to_width: Optional[Tensor],  # noqa: UP045
    *inputs: Any,
) -> Tensor:
    """Compute the tangent [T, B, F, 3, 3] of `project_corners` for tangents of its inputs, [T, ...] or None for 0."""
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
        on_plane = depth.abs() < LEAST_DEPTH
        near = torch.where(on_plane, torch.where(depth < 0, -LEAST_DEPTH, LEAST_DEPTH), depth)
        screen = screen / near
        to_screen = (to_screen - screen * torch.where(on_plane, 0.0, by_depth)) / near / width
        screen, by_width = screen / width, -1 / width
    else:
        to_screen, by_width = to_screen * width, torch.ones_like(width)
    if to_width is not None:
        to_screen = to_screen + screen * by_width * to_width[:, :, None, None]
    to_screen = to_screen / to_screen.new_tensor((aspect, 1.0))
    shape = (*torch.broadcast_shapes(to_screen.shape[:2], (1, batch)), vertices.shape[1])
    screen = torch.cat((to_screen.expand(*shape, 2), by_depth.expand(*shape, 1)), -1)
    repeated = faces if len(faces) == 1 else faces.repeat(len(screen), 1, 1)
    return gather_corners(screen.flatten(0, 1), repeated).unflatten(0, shape[:2])


def rotate(rotation: Tensor, points: Tensor) -> Tensor:
    """Multiply matrices [..., 3, 3] by points [..., V, 3]; not matmul, which may round coordinates to 10 bits."""
    x, y, z = points.split(1, -1)
    columns = rotation[..., None, :, :]
    return x * columns[..., 0] + y * columns[..., 1] + z * columns[..., 2]


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    to_vertices, _, *to_camera = tangents[:5]
    return registration.in_direction(project_corners_forward, (to_vertices, *to_camera), *inputs)


registration.differentiable(project_corners, _to_inputs, registration.save_inputs, _forward)
