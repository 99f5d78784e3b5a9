"""Gathering the values of face corners from shared vertices."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

import torch
from torch import Tensor

from ..warp.elementwise import in_pieces
from ..warp.launch import launch
from ..warp.layout import concurrent, group_tasks
from ..warp.memory import contiguous, empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, operator

_KERNELS = Kernels(__name__, "corners.h")
_GatherCorners, _Triangles, Groups = (_KERNELS.struct(name) for name in ("GatherCorners", "Triangles", "Groups"))
_gather_corners = _KERNELS.kernel("gather_corners", _GatherCorners)
_gather_corners_backward = _KERNELS.kernel("gather_corners_backward", _GatherCorners)


def triangles_of(faces: Tensor, vertices: int) -> Call:
    """Make the `Triangles` of kernels from vertex indices [1 or B, F, 3] int32 of meshes with ``vertices`` vertices."""
    return _Triangles(indices=faces.contiguous(), images=faces.shape[0], count=faces.shape[1], vertices=vertices)


@operator
def gather_corners(vertices: Tensor, faces: Tensor) -> Tensor:
    """Gather the corners of faces [1 or B, F, 3] int32 from vertices [B, V, C] float32; differentiable in the vertices.

    Returns [B, F, 3, C] float32. An index outside [0, V) gives NaN, and no memory there is read; padding (-1, -1, -1)
    gives a face of zeros.
    """
    shape = (vertices.shape[0], *faces.shape[1:], vertices.shape[2])
    corners = empty(shape, vertices.device)
    groups, each = group_tasks(corners.shape[1], vertices.device, 256)
    call = _GatherCorners(
        triangles=triangles_of(faces, vertices.shape[1]),
        tasks=Groups(groups=groups, each=each),
        channels=vertices.shape[2],
        vertices=vertices.contiguous(),
        corners=corners,
    )
    launch(_gather_corners, corners.shape[0] * groups, [call], vertices.device)
    return corners


@fake(gather_corners)
def _(vertices: Tensor, faces: Tensor) -> Tensor:
    return vertices.new_empty((vertices.shape[0], *faces.shape[1:], vertices.shape[2]))


@operator
def gather_corners_backward(grad: Tensor, faces: Tensor, count: int) -> Tensor:
    """Sum the gradient over the corners at each of ``count`` vertices, [B, V, C] float32."""
    batch = grad.shape[0]
    result = zeros((batch, count, grad.shape[3]), grad.device)
    if concurrent(grad.device) and torch.are_deterministic_algorithms_enabled():
        image = torch.arange(batch, device=grad.device)[:, None] * count
        faces = torch.where((faces == -1).all(-1, keepdim=True), 0, faces)
        valid = (faces >= 0) & (faces < count)
        index = (torch.where(valid, faces, 0).flatten(1) + image).flatten()
        part = torch.where(valid[..., None], grad, 0.0)
        return result.flatten(0, 1).index_add_(0, index, part.flatten(0, 2)).view_as(result)
    # One CPU task takes all faces of an image, because additions of several tasks would collide.
    groups, each = (grad.shape[1], 1) if concurrent(grad.device) else (1, grad.shape[1])
    call = _GatherCorners(
        triangles=triangles_of(faces, count),
        tasks=Groups(groups=groups, each=each),
        channels=grad.shape[3],
        vertices=result,
        corners=contiguous(grad),
    )
    launch(_gather_corners_backward, batch * groups, [call], grad.device)
    return result


@fake(gather_corners_backward)
def _(grad: Tensor, faces: Tensor, count: int) -> Tensor:
    return grad.new_empty((grad.shape[0], count, grad.shape[3]))


def _save(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    vertices, faces = inputs
    ctx.count = vertices.shape[1]
    ctx.save_for_backward(faces)


def _to_vertices(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
    return gather_corners_backward(grad, ctx.saved_tensors[0], ctx.count), None


differentiable(gather_corners, _to_vertices, _save, lambda inputs, tangents: gather_corners(tangents[0], inputs[1]))


def _save_again(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    ctx.save_for_backward(inputs[1])


def _to_corners(ctx: Any, vertices: Tensor) -> tuple[Any, ...]:
    corners = gather_corners(vertices, ctx.saved_tensors[0])  # the transpose's transpose; NaN for invalid indices
    return in_pieces(lambda part: part.nan_to_num(nan=0.0), corners, dim=1), None, None


differentiable(
    gather_corners_backward,
    _to_corners,
    _save_again,
    lambda inputs, tangents: gather_corners_backward(tangents[0], *inputs[1:]),
)
