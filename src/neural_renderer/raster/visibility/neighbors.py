"""Neighbours of faces: the adjacent face across each edge, where the surface continues on the screen.

The adjacent face is the drawn face of lowest index that has the same two corners, equal to the last bit, and lies on
the other side of the edge on the screen. An edge at a border or at a fold of the surface has no adjacent face.

No topology is needed: a hash table for each image finds the faces with the same corners. If the mesh's `edge_rings` are
given, the table holds only edges that are alone in their ring, such as those between duplicated vertices.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import FACING, IN_FRONT
from ..warp.launch import array, launch
from ..warp.layout import in_any_order
from ..warp.memory import empty, zeros
from .rings import edges_alone

wp.set_module_options({"enable_backward": False})

# Most faces that are examined at one edge. Without a limit, a pile of equal faces would take quadratic time.
MOST_EQUALS = wp.constant(8)


_LEAST = 512  # faces that are worth another CPU thread


def neighbors(
    faces: Tensor,
    two_sided: bool,
    perspective: bool,
    rings: Tensor | None = None,
    folds: bool = False,
) -> Tensor:
    """Find the adjacent face across each edge, or with ``folds`` the one that the surface folds back to.

    Args:
        faces: Screen-space corners, [B, F, 3, 3] float32.
        two_sided: As in `coverage`.
        perspective: As in `coverage`.
        rings: [1 or B, F + 1, 3] int32 from `edge_rings` for the vertex indices of the faces.
        folds: Find faces with the same two corners on the same side of the edge.

    Returns:
        [B, F, 3] int32: the face across edge k, from corner k to the next; -1 for none and for faces that are not
        drawn.
    """
    batch, count = faces.shape[:2]
    result = empty((batch, count, 3), faces.device, torch.int32)
    corners = array(faces, wp.vec3)
    options, way = [int(two_sided), int(perspective)], 1 if folds else -1
    most = 3 * count
    if rings is not None:
        arguments = [corners, array(rings), *options, way, array(result)]
        launch(_search_rings, batch * count, arguments, faces.device, _LEAST)
        alone_count = edges_alone(rings)
        most = most if alone_count is None else alone_count
    else:
        rings = torch.empty((0, 0, 0), dtype=torch.int32, device=faces.device)
    if most == 0:
        return result
    size = 1 << (2 * most - 1).bit_length()
    table = zeros((batch, size), faces.device, torch.int32)
    # Warp's CPU atomics are not atomic, so on the CPU one task fills an image's table. Several tasks fill it in any
    # order, which decides what faces of an edge beyond MOST_EQUALS are ignored.
    lanes = max(count, 1) if in_any_order(faces.device) else 1
    alone = array(rings)
    launch(_insert_edges, batch * lanes, [corners, array(table), alone, *options, lanes], faces.device)
    launch(
        _search_table, batch * count, [corners, array(table), alone, *options, way, array(result)], faces.device, _LEAST
    )
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
        sum += bits;  // independent of the direction
    }
    sum = (sum ^ (sum >> 16)) * 0xC2B2AE35u;
    return (int)((sum ^ (sum >> 13)) & (unsigned)(size - 1));
"""


@wp.func_native(_HASH)
def edge_hash(p: wp.vec3, q: wp.vec3, size: int) -> int:
    """Compute the first place of an edge in a table of ``size`` places, a power of two."""
    ...


_DRAWN = """
    struct Drawn {
        typedef wp::vec_t<3, float> vec3;
        static CUDA_CALLABLE int facing(vec3 v0, vec3 v1, vec3 v2, int perspective) { FACING }
        static CUDA_CALLABLE int in_front(vec3 v0, vec3 v1, vec3 v2, int perspective) { IN_FRONT }
        static CUDA_CALLABLE bool is(const vec3* v, int two_sided, int perspective) {
            const int side = facing(v[0], v[1], v[2], perspective);
            return (side > 0 || (side < 0 && two_sided)) && in_front(v[0], v[1], v[2], perspective) >= 0;
        }
        static CUDA_CALLABLE float beside(const vec3& p, const vec3& q, const vec3& r, int perspective) {
            const float side = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
            return perspective && r[2] <= 0.0f ? -side : side;  // a corner behind the camera is projected opposite
        }
    };
""".replace("FACING", FACING).replace("IN_FRONT", IN_FRONT)


@wp.func_native(
    _DRAWN + "const wp::vec_t<3, float> corners[3] = {v0, v1, v2}; return Drawn::is(corners, two_sided, perspective);"
)
def is_drawn(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, two_sided: int, perspective: int) -> bool:
    """Test whether a face can be drawn: its side is visible, and it is not wholly behind the camera."""
    ...


@wp.func_native(_DRAWN + "return Drawn::beside(p, q, r, perspective);")
def beside(p: wp.vec3, q: wp.vec3, r: wp.vec3, perspective: int) -> float:
    """Compute a number above zero if the face of p, q and r lies to the left of p -> q on the screen."""
    ...


_SEARCH_RINGS = """
    const wp::int64 count = faces.shape[1], own = b < rings.shape[0] ? b : rings.shape[0] - 1;
    const int* next = rings.data + own * (count + 1) * 3;
    const wp::vec_t<3, float>* corners = faces.data + b * count * 3;
    int* to = result.data + (b * count + f) * 3;
    to[0] = to[1] = to[2] = -1;
    const auto* v = corners + 3 * (wp::int64)f;
    if (!Drawn::is(v, two_sided, perspective)) return;
    for (int k = 0; k < 3; ++k) {
        const auto &p = v[k], &q = v[k == 2 ? 0 : k + 1];
        const float side = Drawn::beside(p, q, v[k == 0 ? 2 : k - 1], perspective);
        int entry = next[3 * f + k];
        for (int n = 0; n < MOST && entry != 3 * f + k; ++n, entry = next[entry]) {
            const int g = entry / 3, m = entry % 3;
            const auto* u = corners + 3 * (wp::int64)g;
            const float same = side * Drawn::beside(p, q, u[m == 0 ? 2 : m - 1], perspective);
            const bool meets = g != f && (float)way * same > 0.0f && Drawn::is(u, two_sided, perspective);
            if (meets && (to[k] < 0 || g < to[k])) to[k] = g;
        }
    }
"""


@wp.func_native(_DRAWN + _SEARCH_RINGS.replace("MOST", str(MOST_EQUALS)))
def search_rings(
    faces: wp.array3d(dtype=wp.vec3),
    rings: wp.array3d(dtype=int),
    two_sided: int,
    perspective: int,
    way: int,
    b: int,
    f: int,
    result: wp.array3d(dtype=int),
):
    """Find the faces adjacent to one face, among those that share the vertices of its edges.

    They lie on the other side of an edge if ``way`` is −1, on the same side if it is 1.
    """
    ...


@wp.kernel
def _search_rings(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    rings: wp.array3d(dtype=int),
    two_sided: int,
    perspective: int,
    way: int,
    result: wp.array3d(dtype=int),
):
    """Find the faces adjacent to one face of one image by the rings of its edges."""
    task = first + wp.tid()
    count = int(faces.shape[1])
    search_rings(faces, rings, two_sided, perspective, way, task // count, task % count, result)


@wp.func
def stands_alone(rings: wp.array3d(dtype=int), b: int, f: int, k: int) -> bool:
    """Test whether an edge is alone in its ring, so that only the table can find its neighbour."""
    if rings.shape[0] == 0:
        return True
    return rings[wp.min(b, rings.shape[0] - 1), f, k] == 3 * f + k


@wp.func
def same(a: wp.vec3, b: wp.vec3) -> bool:
    """Test whether two corners are equal; 0 equals -0."""
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


@wp.func
def same_edge(faces: wp.array3d(dtype=wp.vec3), b: int, entry: int, p: wp.vec3, q: wp.vec3) -> bool:
    """Test whether an entry of the table is the edge p - q, in either direction."""
    f = (entry - 1) // 3
    start = faces[b, f, (entry - 1) % 3]
    end = faces[b, f, entry % 3]
    return (same(start, p) and same(end, q)) or (same(start, q) and same(end, p))


@wp.func
def insert_edge(faces: wp.array3d(dtype=wp.vec3), table: wp.array2d(dtype=int), b: int, f: int, k: int):
    """Insert edge k of face f as 3 f + k + 1 in the next free place, unless the table has MOST_EQUALS equal ones."""
    size = int(table.shape[1])
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
def _insert_edges(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    table: wp.array2d(dtype=int),
    rings: wp.array3d(dtype=int),
    two_sided: int,
    perspective: int,
    lanes: int,
):
    """Insert the edges of every n-th drawn face of an image into its table, a hash table with linear probing."""
    task = first + wp.tid()
    b = task // lanes
    for f in range(task % lanes, faces.shape[1], lanes):
        if is_drawn(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], two_sided, perspective):
            for k in range(3):
                if stands_alone(rings, b, f, k):
                    insert_edge(faces, table, b, f, k)


@wp.kernel
def _search_table(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    table: wp.array2d(dtype=int),
    rings: wp.array3d(dtype=int),
    two_sided: int,
    perspective: int,
    way: int,
    result: wp.array3d(dtype=int),
):
    """Find the faces adjacent to one face of one image by the table of its edges."""
    task = first + wp.tid()
    b = task // int(faces.shape[1])
    f = task % int(faces.shape[1])
    if not is_drawn(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], two_sided, perspective):
        for k in range(3):
            result[b, f, k] = -1
        return
    size = int(table.shape[1])
    for k in range(3):
        if not stands_alone(rings, b, f, k):
            continue
        p = faces[b, f, k]
        q = faces[b, f, (k + 1) % 3]
        side = beside(p, q, faces[b, f, (k + 2) % 3], perspective)
        adjacent = int(-1)
        at = edge_hash(p, q, size)
        entry = table[b, at]
        while entry != 0:
            g = (entry - 1) // 3
            if g != f and same_edge(faces, b, entry, p, q):
                same_side = side * beside(p, q, faces[b, g, (entry + 1) % 3], perspective)
                if float(way) * same_side > 0.0 and (adjacent < 0 or g < adjacent):
                    adjacent = g
            at = (at + 1) & (size - 1)
            entry = table[b, at]
        result[b, f, k] = adjacent
