"""Voxelisation: the voxels that the surface of a mesh intersects, and those that it encloses."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..warp.elsewhere import on_any_device
from ..warp.launch import launch
from ..warp.layout import concurrent
from ..warp.memory import zeros
from ..warp.native import Kernels, constant

# Without fused multiply-adds, adjacent faces agree on lines through their common edge.
_KERNELS = Kernels(__name__, "voxels.h", fused=False)
_Grids, _MarkSurface = _KERNELS.struct("Grids"), _KERNELS.struct("MarkSurface")
_FloodLines, _NearestOnLine = _KERNELS.struct("FloodLines"), _KERNELS.struct("NearestOnLine")
_mark_surface = _KERNELS.kernel("mark_surface", _MarkSurface)
_flood = _KERNELS.kernel("flood", _Grids)
_flood_line = _KERNELS.kernel("flood_line", _FloodLines)
_find_nearest_on_line = _KERNELS.kernel("find_nearest_on_line", _NearestOnLine)

_OUTSIDE = constant("voxels.h", "OUTSIDE")

# Number of lines of voxels that justifies another CPU thread.
_MANY_LINES = 2048


@on_any_device
def fill(vertices: Tensor, faces: Tensor, size: int, spacing: float = math.inf) -> Tensor:
    """Fill meshes, [B, V, 3] float32 in voxels with faces [F, 3] int32, with voxels: [B, size, size, size] bool.

    The edges of voxels lie on lines through integer coordinates. Where such a line meets a face, the four voxels around
    it are marked. Corners mark their voxel, and so do points on the faces at most ``spacing`` voxels apart; half a
    voxel keeps parts thinner than a voxel. Empty voxels connected to the border of the grid through sides of empty
    voxels are outside. All others are filled. Parts outside [0, size] are ignored.
    """
    batch, device = len(vertices), vertices.device
    state = torch.zeros((batch, size, size, size), dtype=torch.uint8, device=device)
    # A task marks one mesh on the CPU and one face on CUDA, where the order of equal writes does not matter.
    groups = max(len(faces), 1) if concurrent(device) else 1
    surface = _MarkSurface(
        grids=_Grids(state=state, size=size),
        vertices=vertices.contiguous(),
        vertex_count=vertices.shape[1],
        faces=faces.contiguous(),
        face_count=len(faces),
        groups=groups,
        spacing=float(spacing),
    )
    launch(_mark_surface, batch * groups, [surface], device)
    if concurrent(device):
        _flood_by_lines(state)
    else:
        launch(_flood, len(state), [_Grids(state=state, size=size)], device)  # one task for each grid
    return state != _OUTSIDE


def _flood_by_lines(state: Tensor) -> None:
    """Mark the empty voxels outside; a task sweeps along one line, until no new voxel is outside."""
    batch, size = state.shape[:2]
    grids, device = _Grids(state=state, size=size), state.device
    changed = zeros((1,), device, torch.int32)
    while True:
        changed.zero_()
        for axis in range(3):
            call = _FloodLines(grids=grids, axis=axis, changed=changed)
            launch(_flood_line, batch * size * size, [call], device)
        if not bool(changed):
            return


@on_any_device
def distances(marked: Tensor) -> Tensor:
    """Compute the distance of each voxel's centre from the nearest marked one, of [B, S, S, S] bool, in voxels.

    The distance is exact: the minimum of squared distances, axis by axis (Felzenszwalb and Huttenlocher, "Distance
    transforms of sampled functions", 2012). For such grid sizes a brute-force minimum is as fast as their algorithm. It
    is infinite where a grid has no marked voxel.
    """
    least = torch.where(marked, 0.0, torch.inf)
    for axis in (1, 2, 3):
        lines = least.movedim(axis, -1).contiguous()
        found = torch.empty_like(lines)
        size = lines.shape[-1]
        call = _NearestOnLine(lines=lines, size=size, nearest=found)
        launch(_find_nearest_on_line, lines.numel() // size, [call], lines.device, _MANY_LINES)
        least = found.movedim(-1, axis)
    return least.sqrt()
