"""Projection by cameras without distortion, fused; replaces about 30 torch operations of `Camera`."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import concurrent, group_tasks, images_of
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels, constant
from ..warp.registration import fake, gradient_of, operator
from .corners import Groups

# Without fused multiply-adds, positions are bitwise those of torch.
_KERNELS = Kernels(__name__, "pinhole.h", fused=False)
_View, _Project, _ProjectBackward = map(_KERNELS.struct, ("View", "Project", "ProjectBackward"))
_project_vertices = _KERNELS.kernel("project_vertices", _Project)
_project_vertices_backward = _KERNELS.kernel("project_vertices_backward", _ProjectBackward)

LEAST_DEPTH = constant("pinhole.h", "LEAST_DEPTH", float)
CAMERA_SUMS = constant("pinhole.h", "CAMERA_SUMS")


@operator
def pinhole(
    vertices: Tensor, rotation: Tensor, origin: Tensor, width: Tensor, aspect: float, perspective: bool
) -> Tensor:
    """Project vertices. `project_corners`, which calls it, is differentiable.

    Args:
        vertices: [1 or B, V, 3] float32, in the world.
        rotation, origin: Axes of the cameras as rows, [1 or B, 3, 3] float32, and their positions, [1 or B, 3].
        width: Tangent of half the field of view, or, without perspective, screen units per world unit, [1 or B].
        aspect: Width / height of the image; x is divided by it.

    Returns:
        [B, V, 3] float32: x, y on the screen, and the depth, by which x and y are divided in perspective.
    """
    batch, count = images_of(vertices, rotation, origin, width), vertices.shape[1]
    screen = empty((batch, count, 3), vertices.device)
    groups, each = group_tasks(count, vertices.device, 1024)
    view = view_of(vertices, rotation, origin, width, aspect, perspective)
    call = _Project(view=view, tasks=Groups(groups=groups, each=each), screen=screen)
    launch(_project_vertices, batch * groups, [call], vertices.device, _LEAST)
    return screen


@fake(pinhole)
def _(vertices: Tensor, rotation: Tensor, origin: Tensor, width: Tensor) -> Tensor:
    return vertices.new_empty((images_of(vertices, rotation, origin, width), vertices.shape[1], 3))


@gradient_of(pinhole, once=True)
def pinhole_backward(grad: Tensor, camera_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `pinhole` to the vertices, [1 or B, V, 3], and to the cameras, [B, CAMERA_SUMS].

    The latter has rotation, origin and width; it is empty if not ``camera_too``.
    """
    vertices = inputs[0]
    batch, count = grad.shape[:2]
    if batch == 0:
        return zeros(vertices.shape, grad.device), grad.new_zeros((0, CAMERA_SUMS))
    groups, each = group_tasks(count, grad.device, 1024, 32)
    # One CPU task sums the gradient to vertices that images share, image by image.
    own = batch if concurrent(grad.device) else len(vertices)
    to_vertices = empty((own, count, 3), grad.device)
    sums = torch.empty((batch, groups, CAMERA_SUMS) if camera_too else (1, 0, CAMERA_SUMS), device=grad.device)
    call = _ProjectBackward(
        view=view_of(*inputs),
        tasks=Groups(groups=groups, each=each),
        grad=grad,
        images=batch,
        targets=own,
        to_vertices=to_vertices,
        sums=sums if camera_too else None,
    )
    launch(_project_vertices_backward, own * groups, [call], grad.device, max(1, _LEAST * own // max(batch, 1)))
    if own > len(vertices):
        to_vertices = to_vertices.sum(0, keepdim=True)
    return to_vertices, sums.sum(1) if camera_too else sums[0]


@fake(pinhole_backward)
def _(grad: Tensor, vertices: Tensor, camera_too: bool) -> tuple[Tensor, Tensor]:
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if camera_too else 0, CAMERA_SUMS))


# Groups of vertices that are worth another thread.
_LEAST = 8


def view_of(*inputs: Any) -> Call:
    """Make the `View` of kernels, from the inputs of `pinhole`."""
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


def parts_of_camera(gradient: Tensor, camera: Sequence[Tensor]) -> dict[str, Tensor]:
    """Split a gradient [B, CAMERA_SUMS] from `pinhole_backward` into those of rotation, origin and width."""
    parts = zip(("rotation", "origin", "width"), camera, gradient.split((9, 3, 1), 1), strict=True)
    return {name: (own if len(given) == len(own) else own.sum(0)).reshape(given.shape) for name, given, own in parts}
