"""On the other side of an edge: the next face of the same surface, or something else."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import facing, in_front
from ..warp.launch import array, concurrent, launch, zeros

wp.set_module_options({"enable_backward": False})

# More faces than this at one edge are left out, or a pile of equal faces would take forever.
MOST_EQUALS = wp.constant(8)


def neighbors(faces: Tensor, two_sided: bool, perspective: bool) -> Tensor:
    """The face with which the surface goes on beyond an edge on the screen; -1 at a border of the surface or a fold.

    faces: [B, F, 3, 3] float32 screen-space corners.
    two_sided, perspective: as in `coverage`.

    Returns [B, F, 3] int32, edge k from corner k to the next; -1 for faces that would not be drawn. The surface goes on
    with a face that would, has the same two corners, to the last bit, and lies on the edge's other side; with
    the one of lowest index if there are several. No topology is asked for, so it works for any faces: the edges are
    found through a hash table for each image.
    """
    batch, count = faces.shape[:2]
    size = 1 << (6 * max(count, 1) - 1).bit_length()
    table = zeros((batch, size), faces.device, torch.int32)
    result = torch.empty((batch, count, 3), dtype=torch.int32, device=faces.device)
    corners = array(faces, wp.vec3)
    # The CPU's atomics are none: there one task fills an image's table alone.
    lanes = max(count, 1) if concurrent(faces.device) else 1
    launch(_insert, batch * lanes, [corners, array(table), int(two_sided), int(perspective), lanes], faces.device)
    arguments = [corners, array(table), int(two_sided), int(perspective), array(result)]
    launch(_find, batch * count, arguments, faces.device)
    return result


_HASH = """
    unsigned sum = 0;
    for (int end = 0; end < 2; ++end) {
        unsigned bits = 0x9E3779B9u;
        for (int k = 0; k < 3; ++k) {
            const float number = (end ? q : p)[k] + 0.0f;  // -0 is 0
            unsigned part;
            memcpy(&part, &number, 4);
            bits = (bits ^ part) * 0x85EBCA6Bu;
            bits ^= bits >> 15;
        }
        sum += bits;  // either end first
    }
    sum = (sum ^ (sum >> 16)) * 0xC2B2AE35u;
    return (int)((sum ^ (sum >> 13)) & (unsigned)(size - 1));
"""


@wp.func_native(_HASH)
def edge_hash(p: wp.vec3, q: wp.vec3, size: int) -> int:
    """Where to begin to look for an edge in a table of ``size``, a power of two."""
    ...


@wp.func
def same(a: wp.vec3, b: wp.vec3) -> bool:
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


@wp.func
def is_drawn(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, two_sided: int, perspective: int) -> bool:
    side = facing(v0, v1, v2, perspective)
    return in_front(v0, v1, v2, perspective) >= 0 and (side > 0 or (side < 0 and two_sided == 1))


@wp.func
def beside(p: wp.vec3, q: wp.vec3, r: wp.vec3, perspective: int) -> float:
    """Above zero if the face of p, q and r lies on the left of p -> q on the screen."""
    side = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    if perspective == 1 and r[2] <= 0.0:
        side = -side  # a corner behind the camera is seen on the wrong side
    return side


@wp.func
def same_edge(faces: wp.array3d(dtype=wp.vec3), b: int, entry: int, p: wp.vec3, q: wp.vec3) -> bool:
    """Whether an entry of the table stands for the edge p - q."""
    f = (entry - 1) // 3
    start = faces[b, f, (entry - 1) % 3]
    end = faces[b, f, entry % 3]
    return (same(start, p) and same(end, q)) or (same(start, q) and same(end, p))


@wp.kernel
def _insert(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    table: wp.array2d(dtype=int),
    two_sided: int,
    perspective: int,
    lanes: int,
):
    """Put every edge of the drawn faces into its image's table, as 3 f + k + 1, in the next free place."""
    task = first + wp.tid()
    b = task // lanes
    size = int(table.shape[1])
    for f in range(task % lanes, faces.shape[1], lanes):
        if is_drawn(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], two_sided, perspective):
            for k in range(3):
                p = faces[b, f, k]
                q = faces[b, f, (k + 1) % 3]
                at = edge_hash(p, q, size)
                equals = int(0)
                entry = wp.atomic_cas(table, b, at, 0, 3 * f + k + 1)
                while entry != 0 and equals < MOST_EQUALS:
                    if same_edge(faces, b, entry, p, q):
                        equals += 1
                    at = (at + 1) & (size - 1)
                    if equals < MOST_EQUALS:
                        entry = wp.atomic_cas(table, b, at, 0, 3 * f + k + 1)


@wp.kernel
def _find(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    table: wp.array2d(dtype=int),
    two_sided: int,
    perspective: int,
    result: wp.array3d(dtype=int),
):
    task = first + wp.tid()
    b = task // int(faces.shape[1])
    f = task % int(faces.shape[1])
    if not is_drawn(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], two_sided, perspective):
        for k in range(3):
            result[b, f, k] = -1
        return
    size = int(table.shape[1])
    for k in range(3):
        p = faces[b, f, k]
        q = faces[b, f, (k + 1) % 3]
        side = beside(p, q, faces[b, f, (k + 2) % 3], perspective)
        beyond = int(-1)
        at = edge_hash(p, q, size)
        entry = table[b, at]
        while entry != 0:
            g = (entry - 1) // 3
            if g != f and same_edge(faces, b, entry, p, q):
                across = side * beside(p, q, faces[b, g, (entry + 1) % 3], perspective)
                if across < 0.0 and (beyond < 0 or g < beyond):
                    beyond = g
            at = (at + 1) & (size - 1)
            entry = table[b, at]
        result[b, f, k] = beyond
