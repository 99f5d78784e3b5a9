"""Gathering the corners of faces from shared vertices."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, concurrent, launch, zeros
from ..warp.registration import differentiable_once, operator

wp.set_module_options({"enable_backward": False})


@operator
def gather_corners(vertices: Tensor, faces: Tensor) -> Tensor:
    """The corners [B, F, 3, 3] of ``faces`` [1 or B, F, 3] int32 among ``vertices`` [B, V, 3] float32; differentiable.

    An index outside [0, V) gives a corner that is not a number, and no memory beyond the vertices is read.
    """
    corners = torch.empty((vertices.shape[0], *faces.shape[1:], 3), dtype=torch.float32, device=vertices.device)
    arguments = [array(vertices, wp.vec3), array(faces), array(corners, wp.vec3)]
    launch(_forward, corners.shape[0] * corners.shape[1], arguments, vertices.device)
    return corners


@torch.library.register_fake("neural_renderer::gather_corners")
def _(vertices, faces):  # type: ignore[no-untyped-def]
    return vertices.new_empty((vertices.shape[0], *faces.shape[1:], 3))


@differentiable_once
def gather_corners_backward(grad: Tensor, faces: Tensor, count: int) -> Tensor:
    """The gradient [B, V, 3] of `gather_corners` to its ``count`` vertices: the sum over the corners at each."""
    batch = grad.shape[0]
    result = zeros((batch, count, 3), grad.device)
    if concurrent(grad.device) and torch.are_deterministic_algorithms_enabled():
        image = torch.arange(batch, device=grad.device)[:, None] * count
        valid = (faces >= 0) & (faces < count)
        index = (torch.where(valid, faces, 0).flatten(1) + image).flatten()
        part = torch.where(valid[..., None], grad, 0.0)
        return result.view(-1, 3).index_add_(0, index, part.reshape(-1, 3)).view_as(result)
    # On the CPU one task takes all faces of an image, since its additions would collide with another task's.
    groups = grad.shape[1] if concurrent(grad.device) else 1
    arguments = [array(grad, wp.vec3), array(faces), groups, array(result, wp.vec3)]
    launch(_backward, batch * groups, arguments, grad.device)
    return result


@torch.library.register_fake("neural_renderer::gather_corners_backward")
def _(grad, faces, count):  # type: ignore[no-untyped-def]
    return grad.new_empty((grad.shape[0], count, 3))


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    vertices, faces = inputs
    ctx.count = vertices.shape[1]
    ctx.save_for_backward(faces)


def _to_vertices(ctx, grad):  # type: ignore[no-untyped-def]
    return gather_corners_backward(grad, ctx.saved_tensors[0], ctx.count), None


torch.library.register_autograd("neural_renderer::gather_corners", _to_vertices, setup_context=_save)


@wp.kernel
def _forward(
    first: int, vertices: wp.array2d(dtype=wp.vec3), faces: wp.array3d(dtype=int), corners: wp.array3d(dtype=wp.vec3)
):
    task = first + wp.tid()
    b = task // corners.shape[1]
    f = task % corners.shape[1]
    for k in range(3):
        v = faces[wp.min(b, faces.shape[0] - 1), f, k]
        if v >= 0 and v < vertices.shape[1]:
            corners[b, f, k] = vertices[b, v]
        else:
            corners[b, f, k] = wp.vec3(wp.nan, wp.nan, wp.nan)


@wp.kernel
def _backward(
    first: int,
    grad: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=int),
    groups: int,
    result: wp.array2d(dtype=wp.vec3),
):
    task = first + wp.tid()
    b = task // groups
    begin = task % groups
    end = begin + 1
    if groups == 1:
        begin = 0
        end = grad.shape[1]
    for f in range(begin, end):
        for k in range(3):
            v = faces[wp.min(b, faces.shape[0] - 1), f, k]
            if v >= 0 and v < result.shape[1]:
                wp.atomic_add(result, b, v, grad[b, f, k])
