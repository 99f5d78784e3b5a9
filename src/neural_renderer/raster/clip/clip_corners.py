"""Triangles in clip space as corners on the screen; those that reach behind the camera are cut."""

from __future__ import annotations

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import readable, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels, constant

# Without fused multiply-adds, as `draw`: triangles with a common edge get the same corners.
_KERNELS = Kernels(__name__, "clip_corners.h", fused=False)
_ClipCorners = _KERNELS.struct("ClipCorners")
_clip_corners = _KERNELS.kernel("clip_corners", _ClipCorners)
_MOST_PARTS = constant("clip_corners.h", "MOST_PARTS")


def clip_corners(mesh: Call, drawn: Call, images: int, device: torch.device) -> Tensor:
    """Compute the corners [B, parts x slots, 3, 3] float32 of the drawn triangles of ``images`` images.

    ``mesh`` and ``drawn`` are a `ClipMesh` and the `DrawnTriangles` of its images. Face p x slots + s is part p of the
    triangle in slot s; NaN for none. Reading the positions on CUDA would synchronise, so there each triangle has room
    for all parts.
    """
    if not readable(device):
        return _placed(mesh, drawn, images, device, _MOST_PARTS)
    behind = zeros((1,), device, torch.int32)
    corners = _placed(mesh, drawn, images, device, 1, behind)
    return _placed(mesh, drawn, images, device, _MOST_PARTS) if int(behind) else corners


def _placed(
    mesh: Call, drawn: Call, images: int, device: torch.device, parts: int, behind: Tensor | None = None
) -> Tensor:
    corners = empty((images, parts * drawn.slots, 3, 3), device)
    call = _ClipCorners(mesh=mesh, drawn=drawn, parts=parts, behind=behind, corners=corners)
    launch(_clip_corners, images * drawn.slots, [call], device, worth_a_thread(32))
    return corners
