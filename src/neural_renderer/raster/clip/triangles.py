"""The visible triangle of each pixel, for vertices in clip space: its weights, depth and their derivatives."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

import math
from typing import Any

import torch
from torch import Tensor

from ..ops.coverage import NEAREST
from ..ops.draw import Drawing, depth_of
from ..ops.peel import BEHIND_LAYER
from ..warp.launch import launch, launch_pixels
from ..warp.layout import concurrent, in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, differentiable_once, fake, operator
from .clip_corners import clip_corners

_KERNELS = Kernels(__name__, "clip.h")
_ClipMesh, _DrawnTriangles = _KERNELS.struct("ClipMesh"), _KERNELS.struct("DrawnTriangles")
_ShowTriangles = _KERNELS.struct("ShowTriangles")
_ShowTrianglesBackward = _KERNELS.struct("ShowTrianglesBackward")
_show_triangles = _KERNELS.kernel("show_triangles", _ShowTriangles)
_show_triangles_backward = _KERNELS.kernel("show_triangles_backward", _ShowTrianglesBackward)

# Depth z / w is drawn as z / w + 2, see `clip_corners.h`. The near and far planes count as inside.
NEAR = math.nextafter(1.0, 0.0) - 1e-7
_DRAWING = Drawing(NEAR, 3.0 + 3e-7, two_sided=True, perspective=False)
_STEP = 1 + 2.0**-20  # a layer begins behind this multiple of the previous layer's depth, a few roundings


def clip_mesh(positions: Tensor, triangles: Tensor, images: int, height: int, width: int) -> Call:
    """Make the `ClipMesh` of kernels from positions [B or 1, V, 4] float32 and triangles [F, 3] int32."""
    return _ClipMesh(
        positions=positions,
        triangles=triangles,
        owners=positions.shape[0],  # not len(), which is Python code in torch
        vertices=positions.shape[1],
        count=triangles.shape[0],
        images=images,
        height=height,
        width=width,
    )


def owner_tasks(owners: int, images: int, height: int, width: int, device: torch.device) -> tuple[int, int]:
    """Divide rows of pixels as `pixel_tasks`, for kernels that sum over the pixels of each of ``owners`` images.

    On the CPU, and if torch requires deterministic results, one task has all pixels of an owner.
    """
    if in_any_order(device):
        return pixel_tasks(images * height, width, device)
    each = images * height // max(owners, 1)
    return (owners, each) if each else (0, 0)


@operator
def show_triangles(
    positions: Tensor,
    triangles: Tensor,
    ranges: Tensor | None,
    slots: int,
    height: int,
    width: int,
    floor: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Find the nearest triangle of each pixel, and the point of it that the pixel shows; differentiable in positions.

    Args:
        positions: Vertices (x, y, z, w) in clip space, [B or 1, V, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        ranges: First triangle and number of triangles of each image, [B, 2] int32; None for all.
        slots: Most triangles of an image.
        height, width: Size of the images in pixels.
        floor: Depth behind which each pixel is drawn, as from the call for the layer in front; None for the near plane.

    Returns:
        (weight of corner 0, weight of corner 1, z / w, triangle + 1), [B, H, W, 4] float32, row 0 at the bottom, 0
        without a triangle; the last two have no gradient. The change of both weights by one pixel, right and up in
        turn, [B, H, W, 4]. With a floor, that of the next layer, [B, H, W]; else empty.
    """
    batch, device = positions.shape[0] if ranges is None else ranges.shape[0], positions.device
    mesh = clip_mesh(positions, triangles, batch, height, width)
    drawn = _DrawnTriangles(ranges=ranges, slots=slots)
    corners = clip_corners(mesh, drawn, batch, device)
    found, floor = _nearest(corners, (batch, height, width), floor)
    rast, changes = empty((batch, height, width, 4), device), empty((batch, height, width, 4), device)
    fields = {"mesh": mesh, "drawn": drawn, **found, "rast": rast, "changes": changes}
    launch_pixels(_show_triangles, _ShowTriangles, batch * height, width, device, **fields)
    return rast, changes, floor


def _nearest(corners: Tensor, shape: tuple[int, int, int], floor: Tensor | None) -> tuple[dict[str, Tensor], Tensor]:
    """Draw the corners; return the field of `ShowTriangles` with the nearest ones, and the next floor."""
    kernels = NEAREST if floor is None else BEHIND_LAYER
    if concurrent(corners.device):
        drawn = kernels.draw_keys(corners, shape, _DRAWING, floor)
        found = {"keys": drawn}
    else:
        found = {"face_index": empty(shape, corners.device, torch.int32)}
        drawn = kernels.draw(corners, found["face_index"], _DRAWING, floor)
    return found, empty((0,), corners.device) if floor is None else depth_of(drawn) * _STEP


@fake(show_triangles)
def _(
    positions: Tensor, ranges: Tensor | None, height: int, width: int, floor: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    shape = (positions.shape[0] if ranges is None else ranges.shape[0], height, width)
    rast, changes = positions.new_empty((*shape, 4)), positions.new_empty((*shape, 4))
    return rast, changes, positions.new_empty((0,) if floor is None else shape)


@differentiable_once
def show_triangles_backward(
    grad: Tensor, grad_of_changes: Tensor | None, rast: Tensor, positions: Tensor, triangles: Tensor
) -> Tensor:
    """Compute the gradient of `show_triangles` to positions, from those of its results, and from its first result."""
    batch, height, width, _ = rast.shape
    to_positions = zeros(positions.shape, positions.device)
    tasks, each = owner_tasks(positions.shape[0], batch, height, width, positions.device)
    call = _ShowTrianglesBackward(
        mesh=clip_mesh(positions, triangles, batch, height, width),
        rast=rast,
        grad=grad,
        grad_of_changes=grad_of_changes,
        each=each,
        to_positions=to_positions,
    )
    launch(_show_triangles_backward, tasks, [call], positions.device, worth_a_thread(each * width))
    return to_positions


@fake(show_triangles_backward)
def _(positions: Tensor) -> Tensor:
    return positions.new_empty(positions.shape)


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    ctx.save_for_backward(*inputs[:2], output[0])
    ctx.set_materialize_grads(False)


def _to_inputs(ctx: Any, grad: Tensor | None, grad_of_changes: Tensor | None, _: Any) -> Any:
    if grad is None and grad_of_changes is None:
        return {}
    positions, triangles, rast = ctx.saved_tensors
    grad = torch.zeros_like(rast) if grad is None else grad
    return {"positions": show_triangles_backward(grad, grad_of_changes, rast, positions, triangles)}


differentiable(show_triangles, _to_inputs, _save)
