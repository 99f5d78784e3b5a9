"""Corners of faces on the screen: `pinhole` and `gather_corners` as one operator.

A small scene spends more time in each call of an operator than in its loops. On CUDA a thread projects the corners of a
face itself, vertices of several faces several times: a launch costs more.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import concurrent, images_of, in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from ..warp.registration import differentiable, differentiable_once, fake, operator
from .corners import gather_corners, gather_corners_backward, triangles_of
from .pinhole import parts_of_camera, pinhole, pinhole_backward, save_projection, view_of

# Without fused multiply-adds, positions are bitwise those of `pinhole`.
_KERNELS = Kernels(__name__, "pinhole.h", fused=False)
_ProjectCorners = _KERNELS.struct("ProjectCorners")
_project_corners = _KERNELS.kernel("project_corners", _ProjectCorners, only_cuda=True)
_project_corners_backward = _KERNELS.kernel("project_corners_backward", _ProjectCorners, only_cuda=True)


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


@fake(project_corners)
def _(vertices: Tensor, faces: Tensor, rotation: Tensor, origin: Tensor, width: Tensor) -> Tensor:
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
    call = _ProjectCorners(
        view=view_of(vertices, rotation, origin, width, aspect, perspective),
        triangles=triangles_of(faces, vertices.shape[1]),
        corners=grad.contiguous(),
        to_vertices=to_vertices,
    )
    launch(_project_corners_backward, len(grad) * faces.shape[1], [call], grad.device)
    return to_vertices, grad.new_empty((0, 13))


@fake(project_corners_backward)
def _(grad: Tensor, vertices: Tensor, camera_too: bool) -> tuple[Tensor, Tensor]:
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if camera_too else 0, 13))


def _to_inputs(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
    vertices, faces, *camera = ctx.saved_tensors
    needed = ctx.needs_input_grad[2:5]
    inputs: list[Any] = [grad, vertices, faces, *camera, ctx.aspect, ctx.perspective, any(needed)]
    to_vertices, to_camera = project_corners_backward(*inputs)
    return to_vertices, None, *parts_of_camera(to_camera, camera, needed), None, None


differentiable(project_corners, _to_inputs, save_projection)
