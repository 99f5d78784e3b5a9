"""Gathering the values of face corners from shared vertices."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.layout import concurrent, group_tasks
from ..warp.memory import empty, zeros
from ..warp.registration import differentiable, operator

wp.set_module_options({"enable_backward": False})


@operator
def gather_corners(vertices: Tensor, faces: Tensor) -> Tensor:
    """Gather the corners of faces; differentiable in the vertices.

    No memory outside the vertices is read.

    Args:
        vertices: [B, V, C] float32.
        faces: Vertex indices, [1 or B, F, 3] int32.

    Returns:
        [B, F, 3, C] float32. An index outside [0, V) gives NaN; padding (-1, -1, -1) gives a face of zeros.
    """
    shape = (vertices.shape[0], *faces.shape[1:], vertices.shape[2])
    corners = empty(shape, vertices.device)
    groups, each = group_tasks(corners.shape[1], vertices.device, 256)
    arguments = [array(vertices), array(faces), array(corners), groups, each]
    launch(_forward, corners.shape[0] * groups, arguments, vertices.device)
    return corners


@torch.library.register_fake("neural_renderer::gather_corners")
def _(vertices, faces):
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
    # On the CPU one task takes all faces of an image, because additions of several tasks would collide.
    groups = grad.shape[1] if concurrent(grad.device) else 1
    arguments = [array(grad), array(faces), groups, array(result)]
    launch(_backward, batch * groups, arguments, grad.device)
    return result


@torch.library.register_fake("neural_renderer::gather_corners_backward")
def _(grad, faces, count):
    return grad.new_empty((grad.shape[0], count, grad.shape[3]))


def _save(ctx, inputs, output):
    vertices, faces = inputs
    ctx.count = vertices.shape[1]
    ctx.save_for_backward(faces)


def _to_vertices(ctx, grad):
    return gather_corners_backward(grad, ctx.saved_tensors[0], ctx.count), None


differentiable(gather_corners, _to_vertices, _save)


def _save_again(ctx, inputs, output):
    ctx.save_for_backward(inputs[1])


def _to_corners(ctx, vertices):
    corners = gather_corners(vertices, ctx.saved_tensors[0])  # the transpose's transpose; NaN for invalid indices
    return corners.nan_to_num(nan=0.0), None, None


differentiable(gather_corners_backward, _to_corners, _save_again)


# The vertex indices of face f in image b. Then the vertex i of its corner k, and whether it is one of `count` vertices.
FACE = """
    const int* face = faces.data + ((b < faces.shape[0] ? b : faces.shape[0] - 1) * (wp::int64)faces.shape[1] + f) * 3;
    const bool none = (face[0] & face[1] & face[2]) == -1;
"""
CORNER = """
    const int i = none ? 0 : face[k];
    const bool valid = i >= 0 && i < count;
"""

_EACH = f"""
    const int count = vertices.shape[1], channels = vertices.shape[2];
    const wp::int64 all = faces.shape[1];
    for (wp::int64 f = begin; f < end; ++f) {{
        {FACE}
        for (int k = 0; k < 3; ++k) {{
            {CORNER}
            float* vertex = vertices.data + ((wp::int64)b * count + (valid ? i : 0)) * channels;
            float* corner = corners.data + ((b * all + f) * 3 + k) * channels;
            if (channels == 3) {{ const int channels = 3; DO }}
            else {{ DO }}
        }}
    }}
"""


@wp.func_native(_EACH.replace("DO", "for (int c = 0; c < channels; ++c) corner[c] = valid ? vertex[c] : NAN;"))
def copy_out(
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    corners: wp.array4d(dtype=float),
    b: int,
    begin: int,
    end: int,
):
    """Copy the corners of the faces [begin, end) of an image."""
    ...


_ADD = """
            for (int c = 0; valid && c < channels; ++c) ADD;
"""


# Plain additions on the CPU, because Warp's CPU atomics are slow function calls.
@wp.func_native(
    "#if defined(__CUDA_ARCH__)"
    + _EACH.replace("DO", _ADD).replace("ADD", "wp::atomic_add(vertex + c, corner[c])")
    + "#else"
    + _EACH.replace("DO", _ADD).replace("ADD", "vertex[c] += corner[c]")
    + "#endif\n"
)
def add_in(
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    corners: wp.array4d(dtype=float),
    b: int,
    begin: int,
    end: int,
):
    """Add corners of the faces [begin, end) to the vertices: the transpose of `copy_out`."""
    ...


@wp.kernel
def _forward(
    first: int,
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    corners: wp.array4d(dtype=float),
    groups: int,
    each: int,
):
    task = first + wp.tid()
    begin = (task % groups) * each
    copy_out(vertices, faces, corners, task // groups, begin, wp.min(begin + each, corners.shape[1]))


@wp.kernel
def _backward(
    first: int,
    grad: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=int),
    groups: int,
    result: wp.array3d(dtype=float),
):
    task = first + wp.tid()
    begin = task % groups
    end = begin + 1
    if groups == 1:
        begin = 0
        end = grad.shape[1]
    add_in(result, faces, grad, task // groups, begin, end)
