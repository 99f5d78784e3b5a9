"""The visible triangle of each pixel, for vertices in clip space: its weights, depth and their derivatives."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

import math
from typing import Any

import torch
from torch import Tensor

from ..ops.corners import gather_corners
from ..ops.draw import Drawing
from ..ops.peel import draw_behind
from ..warp.launch import launch, launch_pixels
from ..warp.layout import in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, gradient_of, operator

_KERNELS = Kernels(__name__, "clip.h")
_ClipMesh, _ShowTriangles = _KERNELS.struct("ClipMesh"), _KERNELS.struct("ShowTriangles")
_ShowTrianglesBackward = _KERNELS.struct("ShowTrianglesBackward")
_show_triangles = _KERNELS.kernel("show_triangles", _ShowTriangles)
_show_triangles_backward = _KERNELS.kernel("show_triangles_backward", _ShowTrianglesBackward)

# Depth z / w is drawn as z / w + 2, because drawing needs positive depths. The near and far planes count as inside.
_DEPTH = 2.0
_NEAR, _FAR = math.nextafter(1.0, 0.0) - 1e-7, 3.0 + 3e-7


def clip_mesh(positions: Tensor, triangles: Tensor, images: int, height: int, width: int) -> Call:
    """Make the `ClipMesh` of kernels from positions [B or 1, V, 4] float32 and triangles [F, 3] int32."""
    return _ClipMesh(
        positions=positions,
        triangles=triangles,
        owners=len(positions),
        vertices=positions.shape[1],
        count=len(triangles),
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


class NearestTriangles:
    """The nearest triangles of each pixel, layer by layer.

    Positions are vertices (x, y, z, w) in clip space, [1 or B, V, 4] float32, without a gradient; ``ranges`` the first
    triangle and the number of triangles of each image, [B, 2] int32 on the CPU, or None for all.
    """

    def __init__(self, positions: Tensor, triangles: Tensor, ranges: Tensor | None, height: int, width: int) -> None:
        device, count = positions.device, len(triangles)
        own, self._numbers = triangles[None], torch.arange(count, dtype=torch.int32, device=device)[None]
        if ranges is not None:
            each = torch.arange(int(ranges[:, 1].max()), dtype=torch.int32)[None]
            numbers = torch.where(each < ranges[:, 1:], ranges[:, :1] + each, -1).to(device)
            own = torch.where(numbers[..., None] < 0, -1, triangles[numbers.clamp(min=0).long()])
            self._numbers, positions = numbers, positions.expand(len(ranges), -1, -1)
        screen = positions[..., :3] / positions[..., 3:]
        # Row 0 of images that are drawn is at the top.
        corners = gather_corners(screen * screen.new_tensor([1, -1, 1]) + screen.new_tensor([0, 0, _DEPTH]), own)
        if bool((positions[..., 3] <= 0).any()):
            corners = self._clip(gather_corners(positions, own), corners)
        self._corners, self._shape = corners, (len(positions), height, width)
        self._floor = torch.full(self._shape, _NEAR, device=device)

    def _clip(self, inside: Tensor, corners: Tensor) -> Tensor:
        """Replace triangles that reach behind the camera by the parts between the near and far planes.

        The parts follow after all triangles; their indices are those of the triangles that were cut.
        """
        behind = (inside[..., 3] <= 0).any(2)
        image, f = behind.nonzero(as_tuple=True)
        parts = inside[image, f].double()
        for sign in (1.0, -1.0):
            parts = _parts_above(parts, parts[..., 3] + sign * parts[..., 2])
        parts = parts.view(4, len(f), 3, 4)
        screen = torch.cat((parts[..., :1], -parts[..., 1:2], parts[..., 2:3]), -1) / parts[..., 3:]
        screen = (screen + screen.new_tensor([0, 0, _DEPTH])).float()
        batch = len(behind)
        most = int(behind.sum(1).max()) if len(f) else 0
        place = behind.long().cumsum(1)[image, f] - 1
        extra = corners.new_full((batch, len(parts), most, 3, 3), torch.nan)
        extra[image, :, place] = screen.movedim(0, 1)
        numbers = self._numbers.expand(batch, -1)
        owner = numbers.new_full((batch, len(parts), most), -1)
        owner[image, :, place] = numbers[image, f][:, None].expand(-1, len(parts))
        self._numbers = torch.cat((numbers, owner.flatten(1)), 1)
        whole = torch.where(behind[..., None, None], torch.nan, corners)
        return torch.cat((whole, extra.flatten(1, 2)), 1)

    def next_layer(self) -> Tensor:
        """Find each pixel's nearest triangle behind the last layer, [B, H, W] int32, row 0 at the bottom."""
        face_index = empty(self._shape, self._corners.device, torch.int32)
        self._floor = draw_behind(self._corners, face_index, Drawing(_NEAR, _FAR, True, False), self._floor, _STEP)
        if self._numbers.shape[1] == 0:
            return face_index
        numbers = self._numbers.expand(len(face_index), -1)
        found = numbers.gather(1, face_index.clamp(min=0).flatten(1).long()).view_as(face_index)
        return torch.where(face_index < 0, -1, found)


_STEP = 1 + 2.0**-20  # a layer begins behind this multiple of the previous layer's depth, a few roundings


def _parts_above(parts: Tensor, height: Tensor) -> Tensor:
    """Clip triangles [N, 3, 4] to where ``height`` [N, 3] is positive; returns [2 N, 3, 4] triangles, NaN for none.

    One step of Sutherland and Hodgman, "Reentrant polygon clipping", 1974.
    """
    above = height > 0
    number = above.sum(1)
    # Rotate the corners so that corner 0 is the only one on its side of the plane.
    single = torch.where(number == 1, above.int().argmax(1), (~above).int().argmax(1))
    order = (single[:, None] + torch.arange(3, device=parts.device)) % 3
    p = parts.gather(1, order[..., None].expand_as(parts))
    h = height.gather(1, order)[..., None]
    first, second = (p[:, 0] + (p[:, k] - p[:, 0]) * (h[:, 0] / (h[:, 0] - h[:, k])) for k in (1, 2))
    none = torch.full_like(parts, torch.nan)
    tip = torch.stack((p[:, 0], first, second), 1)
    base = torch.stack((first, p[:, 1], p[:, 2]), 1)
    rest = torch.stack((first, p[:, 2], second), 1)
    case = number[:, None, None]
    one = torch.where(case == 3, parts, torch.where(case == 1, tip, torch.where(case == 2, base, none)))
    return torch.cat((one, torch.where(case == 2, rest, none)))


@operator
def show_triangles(positions: Tensor, triangles: Tensor, face_index: Tensor) -> tuple[Tensor, Tensor]:
    """Compute weights, depth and derivatives of the point that each pixel shows; differentiable in the positions.

    Args:
        positions: Vertices (x, y, z, w) in clip space, [B or 1, V, 4] float32.
        triangles: Vertex indices, [F, 3] int32.
        face_index: Triangle of each pixel, [B, H, W] int32, row 0 at the bottom; −1 for none.

    Returns:
        (weight of corner 0, weight of corner 1, z / w, triangle + 1), [B, H, W, 4] float32, 0 without a triangle; the
        last two have no gradient. The change of both weights by one pixel, right and up in turn, [B, H, W, 4].
    """
    batch, height, width = face_index.shape
    device = positions.device
    rast, changes = empty((batch, height, width, 4), device), empty((batch, height, width, 4), device)
    mesh = clip_mesh(positions, triangles, batch, height, width)
    fields = {"mesh": mesh, "face_index": face_index, "rast": rast, "changes": changes}
    launch_pixels(_show_triangles, _ShowTriangles, batch * height, width, device, **fields)
    return rast, changes


@fake(show_triangles)
def _(positions: Tensor, face_index: Tensor) -> tuple[Tensor, Tensor]:
    shape = (*face_index.shape, 4)
    return positions.new_empty(shape), positions.new_empty(shape)


@gradient_of(show_triangles, "positions", once=True, leave_out="face_index")
def show_triangles_backward(grad: Tensor, grad_of_changes: Tensor | None, rast: Tensor, *inputs: Any) -> Tensor:
    """Compute the gradient of `show_triangles` to positions, from those of its results, and from its first result."""
    positions, triangles = inputs
    batch, height, width, _ = rast.shape
    to_positions = zeros(positions.shape, positions.device)
    tasks, each = owner_tasks(len(positions), batch, height, width, positions.device)
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


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    positions, triangles, _ = inputs
    ctx.save_for_backward(positions, triangles, output[0])
    ctx.set_materialize_grads(False)


def _to_inputs(ctx: Any, grad: Tensor | None, grad_of_changes: Tensor | None) -> Any:
    positions, triangles, rast = ctx.saved_tensors
    if grad is None and grad_of_changes is None:
        return {}
    grad = torch.zeros_like(rast) if grad is None else grad
    return {"positions": show_triangles_backward(grad, grad_of_changes, rast, positions, triangles)}


differentiable(show_triangles, _to_inputs, _save)
