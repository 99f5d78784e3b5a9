"""Voxelisation: the voxels that the surface of a mesh passes through, and those that it encloses."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import math

import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch, load_kernel
from ..warp.layout import concurrent
from ..warp.memory import zeros

# Without fused multiply-adds adjacent faces agree on lines through their common edge.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_EMPTY = wp.constant(wp.uint8(0))
_SURFACE = wp.constant(wp.uint8(1))
_OUTSIDE = wp.constant(wp.uint8(2))

# Number of points or lines that are worth another CPU thread.
_MANY_POINTS = 2048


def fill(vertices: Tensor, faces: Tensor, size: int, spacing: float = math.inf) -> Tensor:
    """Fill meshes with voxels.

    The edges of voxels lie on lines through integer coordinates. Where such a line meets a face, the four voxels around
    it are marked. Corners mark their voxel, and so do points on the faces at most ``spacing`` apart; half a voxel keeps
    parts thinner than a voxel. Empty voxels connected to the border of the grid through sides of empty voxels are
    outside. All others are filled.

    Args:
        vertices: [B, V, 3] float32 in voxels; parts outside [0, size] are ignored.
        faces: Vertex indices, [F, 3] int32.
        size: Voxels along each side of the grid.
        spacing: Largest distance between points on the faces, in voxels.

    Returns:
        [B, size, size, size] bool; voxel (i, j, k) is [i, i + 1] × [j, j + 1] × [k, k + 1].
    """
    batch, device = len(vertices), vertices.device
    state = torch.zeros((batch, size, size, size), dtype=torch.uint8, device=device)
    # A task marks one mesh on the CPU and one face on CUDA, where the order of equal writes does not matter.
    groups = max(len(faces), 1) if concurrent(device) else 1
    points, corners = array(vertices, wp.vec3), array(faces)
    launch(_mark, batch * groups, [points, corners, groups, float(spacing), array(state)], device)
    if concurrent(device):
        _flood_lines(state)
    else:
        launch(_flood, batch, [array(state)], device)
    return state != 2


def _flood_lines(state: Tensor) -> None:
    """Do the same as `_flood`, one line of voxels for each task, until no new voxel is outside."""
    batch, size = state.shape[:2]
    changed = zeros((1,), state.device, torch.int32)
    while True:
        changed.zero_()
        for axis in range(3):
            launch(_flood_line, batch * size * size, [array(state), axis, array(changed)], state.device)
        if not bool(changed):
            return


def inside(vertices: Tensor, faces: Tensor, points: Tensor, least: float = 0.5) -> Tensor:
    """Test which points are inside a mesh, by winding numbers.

    A point is inside if its winding number is above ``least`` (Jacobson, Kavan and Sorkine-Hornung, "Robust
    inside-outside segmentation using generalized winding numbers", 2013). A hole affects only the points near it.

    Args:
        vertices: [V, 3] float32 on the CPU.
        faces: Vertex indices, [F, 3] int32; counter-clockwise seen from outside.
        points: [P, 3] float32.
        least: Least winding number of points inside.

    Returns:
        [P] bool.
    """
    result = torch.zeros(len(points), dtype=torch.uint8)
    load_kernel(_wind, "cpu")  # before Warp's first array, which would start it with a banner
    corners = wp.array(faces.reshape(-1).numpy(), dtype=int, device="cpu")
    mesh = wp.Mesh(wp.array(vertices.numpy(), dtype=wp.vec3, device="cpu"), corners, support_winding_number=True)
    launch(_wind, len(points), [mesh.id, array(points, wp.vec3), least, array(result)], points.device, _MANY_POINTS)
    return result == 1


def distances(marked: Tensor) -> Tensor:
    """Compute the distance of each voxel's centre from the nearest marked one.

    The distance is exact: the minimum of squared distances, axis by axis (Felzenszwalb and Huttenlocher, "Distance
    transforms of sampled functions", 2012). For grids of this size a plain minimum is as fast as theirs.

    Args:
        marked: [B, S, S, S] bool.

    Returns:
        [B, S, S, S] float32 in voxels; infinite where a grid has no marked voxel.
    """
    least = torch.where(marked, 0.0, torch.inf)
    for axis in (1, 2, 3):
        lines = least.movedim(axis, -1).contiguous()
        found = torch.empty_like(lines)
        size = lines.shape[-1]
        arguments = [array(lines.reshape(-1, size)), array(found.reshape(-1, size))]
        launch(_nearest, lines.numel() // size, arguments, lines.device, _MANY_POINTS)
        least = found.movedim(-1, axis)
    return least.sqrt()


@wp.func
def whole_from(number: float) -> int:
    """Round up to an integer."""
    return int(wp.ceil(number))


@wp.func
def turn(p: wp.vec3, axis: int) -> wp.vec3:
    """Rotate the coordinates of a point so that ``axis`` is the last."""
    return wp.vec3(p[(axis + 1) % 3], p[(axis + 2) % 3], p[axis])


@wp.func
def mark(state: wp.array4d(dtype=wp.uint8), b: int, axis: int, x: float, y: float, z: float):
    """Mark the voxel of a point, at (x, y) across ``axis`` and z along it, if it is in the grid."""
    size = float(state.shape[1])
    # Tested before the conversion, which makes different integers of NaN on different devices.
    if x >= 0.0 and x < size and y >= 0.0 and y < size and z >= 0.0 and z < size:
        p = int(x)
        q = int(y)
        along = int(z)
        if axis == 0:
            state[b, along, p, q] = _SURFACE
        elif axis == 1:
            state[b, q, along, p] = _SURFACE
        else:
            state[b, p, q, along] = _SURFACE


@wp.func
def mark_lines(state: wp.array4d(dtype=wp.uint8), b: int, axis: int, v0: wp.vec3, v1: wp.vec3, v2: wp.vec3):
    """Mark the voxels where lines along ``axis``, the last coordinate of the corners, meet a face."""
    size = float(state.shape[1])
    low = wp.vec3(wp.min(v0[0], wp.min(v1[0], v2[0])), wp.min(v0[1], wp.min(v1[1], v2[1])), 0.0)
    high = wp.vec3(wp.max(v0[0], wp.max(v1[0], v2[0])), wp.max(v0[1], wp.max(v1[1], v2[1])), 0.0)
    p_last = int(wp.floor(wp.min(high[0], size)))
    q_last = int(wp.floor(wp.min(high[1], size)))
    for p in range(whole_from(wp.max(low[0], 0.0)), p_last + 1):
        for q in range(whole_from(wp.max(low[1], 0.0)), q_last + 1):
            x = float(p)
            y = float(q)
            e0 = (v1[0] - x) * (v2[1] - y) - (v1[1] - y) * (v2[0] - x)
            e1 = (v2[0] - x) * (v0[1] - y) - (v2[1] - y) * (v0[0] - x)
            e2 = (v0[0] - x) * (v1[1] - y) - (v0[1] - y) * (v1[0] - x)
            area = e0 + e1 + e2
            if area != 0.0 and e0 * area >= 0.0 and e1 * area >= 0.0 and e2 * area >= 0.0:
                along = (e0 * v0[2] + e1 * v1[2] + e2 * v2[2]) / area
                for i in range(4):
                    mark(state, b, axis, float(p - i % 2), float(q - i // 2), along)


@wp.func
def mark_points(state: wp.array4d(dtype=wp.uint8), b: int, v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, spacing: float):
    """Mark the voxels of a face's corners, and of points between them at most ``spacing`` apart."""
    longest = wp.max(wp.length(v1 - v0), wp.max(wp.length(v2 - v1), wp.length(v0 - v2)))
    steps = int(wp.clamp(wp.ceil(longest / spacing), 1.0, 1024.0))
    for i in range(steps + 1):
        for j in range(steps + 1 - i):
            p = v0 + (float(i) * (v1 - v0) + float(j) * (v2 - v0)) / float(steps)
            mark(state, b, 2, p[0], p[1], p[2])


@wp.kernel
def _mark(
    first: int,
    vertices: wp.array2d(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    groups: int,
    spacing: float,
    state: wp.array4d(dtype=wp.uint8),
):
    task = first + wp.tid()
    b = task // groups
    for f in range(task % groups, faces.shape[0], groups):
        v0 = vertices[b, faces[f, 0]]
        v1 = vertices[b, faces[f, 1]]
        v2 = vertices[b, faces[f, 2]]
        mark_points(state, b, v0, v1, v2, spacing)
        for k in range(3):
            mark_lines(state, b, k, turn(v0, k), turn(v1, k), turn(v2, k))


@wp.func
def reached(state: wp.array4d(dtype=wp.uint8), b: int, i: int, j: int, k: int) -> bool:
    """Test whether an empty voxel is at the border of the grid or beside an outside voxel."""
    last = int(state.shape[1]) - 1
    if i == 0 or j == 0 or k == 0 or i == last or j == last or k == last:
        return True
    if state[b, i - 1, j, k] == _OUTSIDE or state[b, i, j - 1, k] == _OUTSIDE or state[b, i, j, k - 1] == _OUTSIDE:
        return True
    return state[b, i + 1, j, k] == _OUTSIDE or state[b, i, j + 1, k] == _OUTSIDE or state[b, i, j, k + 1] == _OUTSIDE


@wp.kernel
def _flood(first: int, state: wp.array4d(dtype=wp.uint8)):
    """Sweep forward and backward until no new voxel is outside. All grids but mazes need a few sweeps."""
    b = first + wp.tid()
    size = int(state.shape[1])
    count = size * size * size
    changed = int(1)
    backward = int(0)
    while changed != 0:
        changed = int(0)
        for step in range(count):
            at = step
            if backward == 1:
                at = count - 1 - step
            i = at // (size * size)
            j = (at // size) % size
            k = at % size
            if state[b, i, j, k] == _EMPTY and reached(state, b, i, j, k):
                state[b, i, j, k] = _OUTSIDE
                changed += 1
        backward = 1 - backward


@wp.func
def voxel_of(axis: int, p: int, q: int, along: int) -> wp.vec3i:
    """Find the voxel at (p, q) across ``axis`` and ``along`` it."""
    if axis == 0:
        return wp.vec3i(along, p, q)
    if axis == 1:
        return wp.vec3i(q, along, p)
    return wp.vec3i(p, q, along)


@wp.kernel
def _flood_line(first: int, state: wp.array4d(dtype=wp.uint8), axis: int, changed: wp.array1d(dtype=int)):
    """Sweep along one line of voxels, forward and backward. It reads and writes no other voxels."""
    task = first + wp.tid()
    size = int(state.shape[1])
    b = task // (size * size)
    p = (task // size) % size
    q = task % size
    beside = p == 0 or q == 0 or p == size - 1 or q == size - 1
    outside = bool(True)  # before the first voxel
    for step in range(2 * size):
        along = step
        if step >= size:
            along = 2 * size - 1 - step
        if step == size:
            outside = True
        at = voxel_of(axis, p, q, along)
        found = state[b, at[0], at[1], at[2]]
        if found == _EMPTY and (outside or beside):
            found = _OUTSIDE
            state[b, at[0], at[1], at[2]] = found
            changed[0] = 1
        outside = found == _OUTSIDE


@wp.kernel
def _wind(first: int, mesh: wp.uint64, points: wp.array(dtype=wp.vec3), least: float, result: wp.array(dtype=wp.uint8)):
    task = first + wp.tid()
    found = wp.mesh_query_point_sign_winding_number(mesh, points[task], 1.0e6, 2.0, least)
    result[task] = wp.where(found.result and found.sign < 0.0, _SURFACE, _EMPTY)


@wp.kernel
def _nearest(first: int, lines: wp.array2d(dtype=float), result: wp.array2d(dtype=float)):
    task = first + wp.tid()
    size = int(lines.shape[1])
    for i in range(size):
        best = lines[task, i]
        for j in range(size):
            reach = lines[task, j] + float((i - j) * (i - j))
            if reach < best:  # faster than wp.min, which tests for NaN
                best = reach
        result[task, i] = best
