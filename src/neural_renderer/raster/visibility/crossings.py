"""Crossings of edges with scan lines: their positions, the pixels and faces beside them, and the chords of faces.

Scan lines are the rows of an image (axis 0) or its columns (axis 1). Rows measure the motion of edges along x, columns
along y. A line has the number u, and a position on it is v, both in pixels from the bottom left; pixel centres are the
integers.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import SHORTEST, to_pixels
from .scanlines import place

wp.set_module_options({"enable_backward": False})

# A crossing is weighted by the inverse of a chord in pixels, the probability that a pixel centre hits the chord. The
# weight is at most 1 / LEAST_CHORD, to limit noise. This loses part of the gradient of shorter chords.
LEAST_CHORD = wp.constant(0.02)


@wp.struct
class Edge:
    """An edge p -> q of a counter-clockwise face with third corner r; u, v in pixels and depth z of each."""

    image: int
    face: int
    # The adjacent faces across p-q, p-r and q-r; -1 at a border of the surface.
    adjacent: int
    adjacent_pr: int
    adjacent_qr: int
    small: bool  # whether the face or the adjacent one has less than a few pixels; see `seams`
    axis: int
    lines: int  # number of scan lines
    length: int  # pixels of a line
    outward: int  # direction along v out of the face: 1 or -1
    pu: float
    pv: float
    pz: float
    qu: float
    qv: float
    qz: float
    ru: float
    rv: float
    rz: float
    slope: float  # dv / du


@wp.struct
class Crossing:
    """The point where a scan line crosses an edge, between the centres of two pixels."""

    u: int
    v: float
    share: float  # of q in the motion of the point, in [0, 1]; p has the rest
    inner: int  # the pixel on the face's side
    outer: int  # the pixel across the edge
    offset: float  # from the inner pixel's centre to the point, in [0, 1]
    inner_face: int  # visible there; -1 for none, -2 outside the image
    outer_face: int


@wp.func
def scanned_edge(p: wp.vec3, q: wp.vec3, r: wp.vec3, axis: int, height: int, width: int) -> Edge:
    """Convert an edge and the third corner of its face from screen units to scan lines of one axis."""
    edge = Edge()
    edge.axis = axis
    edge.lines = width
    edge.length = height
    if axis == 0:
        edge.lines = height
        edge.length = width
    edge.pu = to_pixels(p[1 - axis], edge.lines)
    edge.qu = to_pixels(q[1 - axis], edge.lines)
    edge.ru = to_pixels(r[1 - axis], edge.lines)
    edge.pv = to_pixels(p[axis], edge.length)
    edge.qv = to_pixels(q[axis], edge.length)
    edge.rv = to_pixels(r[axis], edge.length)
    edge.pz = p[2]
    edge.qz = q[2]
    edge.rz = r[2]
    edge.slope = (edge.qv - edge.pv) / (edge.qu - edge.pu)
    edge.outward = 1
    if (edge.pu < edge.qu) == (axis == 1):
        edge.outward = -1
    return edge


@wp.func
def has_crossings(edge: Edge, perspective: int) -> bool:
    """Test whether an edge has a slope and both ends on the screen."""
    return not (wp.abs(edge.pu - edge.qu) < SHORTEST or (perspective == 1 and (edge.pz <= 0.0 or edge.qz <= 0.0)))


@wp.func
def first_line(edge: Edge) -> int:
    """Find the first scan line that crosses an edge."""
    return int(wp.ceil(wp.clamp(wp.min(edge.pu, edge.qu), 0.0, float(edge.lines))))


@wp.func
def end_line(edge: Edge) -> int:
    """Find the scan line after the last one that crosses an edge; a line through a shared corner counts once."""
    return int(wp.ceil(wp.clamp(wp.max(edge.pu, edge.qu), 0.0, float(edge.lines))))


@wp.func
def crossing_on(edge: Edge, u: int, face_index: wp.array3d(dtype=int)) -> Crossing:
    """Find the crossing of an edge on scan line u, with the pixels and the visible faces beside it."""
    at = Crossing()
    at.u = u
    at.v = wp.clamp(edge.pv + edge.slope * (float(u) - edge.pu), -2.0, float(edge.length) + 1.0)
    at.share = (float(u) - edge.pu) / (edge.qu - edge.pu)
    inner = int(wp.ceil(at.v))
    if edge.outward > 0:
        inner = int(wp.floor(at.v))
    at.inner = inner
    at.outer = inner + edge.outward
    at.offset = wp.abs(at.v - float(inner))
    at.inner_face = face_at(face_index, edge.image, edge.axis, u, inner, edge.length)
    at.outer_face = face_at(face_index, edge.image, edge.axis, u, at.outer, edge.length)
    return at


@wp.func
def separates_faces(at: Crossing) -> bool:
    """Test whether the two pixels beside a crossing are in the image and show different faces."""
    return at.inner_face != -2 and at.outer_face != -2 and at.inner_face != at.outer_face


@wp.func
def leaves_through_pr(edge: Edge, u: int) -> bool:
    """Test whether scan line u, which crosses p-q, leaves the face through p-r rather than q-r."""
    return (edge.pu <= float(u)) != (edge.ru <= float(u))


@wp.func
def exit_from_face(edge: Edge, u: int) -> float:
    """Find the position where scan line u, which crosses p-q, leaves the face."""
    v = edge.rv
    if leaves_through_pr(edge, u):
        v = edge.pv + (edge.rv - edge.pv) * (float(u) - edge.pu) / (edge.ru - edge.pu)
    elif edge.qu != edge.ru:
        v = edge.qv + (edge.rv - edge.qv) * (float(u) - edge.qu) / (edge.ru - edge.qu)
    return v


# Plain C++ for its speed. Positions in pixels are those of `to_pixels`.
_CHORD = """
    const auto* corners = faces.data + ((wp::int64)image * faces.shape[1] + face) * 3;
    float across[3], along[3], end = entry;
    for (int k = 0; k < 3; ++k) {
        across[k] = 0.5f * ((float)lines * corners[k][1 - axis] + (float)(lines - 1));
        along[k] = 0.5f * ((float)length * corners[k][axis] + (float)(length - 1));
    }
    for (int k = 0; k < 3; ++k) {
        const int m = k == 2 ? 0 : k + 1;
        if ((across[k] <= (float)u) == (across[m] <= (float)u)) continue;
        const float v = along[k] + (along[m] - along[k]) * ((float)u - across[k]) / (across[m] - across[k]);
        end = fabsf(v - entry) > fabsf(end - entry) ? v : end;
    }
    const float result = fabsf(end - start);
    return result < 1.0f ? result : 1.0f;
"""


@wp.func_native(_CHORD)
def chord_of(
    faces: wp.array3d(dtype=wp.vec3),
    image: int,
    face: int,
    axis: int,
    lines: int,
    length: int,
    u: int,
    entry: float,
    start: float,
) -> float:
    """Measure a chord; see `chord`."""
    ...


@wp.func
def chord(faces: wp.array3d(dtype=wp.vec3), face: int, edge: Edge, u: int, entry: float, start: float) -> float:
    """Measure from ``start`` to the exit of scan line u from a face, which it enters at ``entry``; at most a pixel."""
    return chord_of(faces, edge.image, face, edge.axis, edge.lines, edge.length, u, entry, start)


@wp.func
def border_weight(v: float, length: int) -> float:
    """Weight a position on a line of ``length`` pixels: 2 within half a pixel of the first or last centre, else 1.

    Pairs of centres sample only the inner half of a border pixel, so that half counts for both.
    """
    if v < 0.5 or v > float(length) - 1.5:
        return 2.0
    return 1.0


@wp.func
def pixel_at(image: wp.array4d(dtype=float), b: int, axis: int, u: int, v: int) -> wp.int64:
    """Compute the offset in memory of pixel v of scan line u, in the first channel of image b."""
    row, column = place(axis, u, v, image.shape[2])
    first_row = wp.int64(b) * wp.int64(image.shape[1]) * wp.int64(image.shape[2])
    return (first_row + wp.int64(row)) * wp.int64(image.shape[3]) + wp.int64(column)


@wp.func
def face_at(face_index: wp.array3d(dtype=int), b: int, axis: int, u: int, v: int, length: int) -> int:
    """Read the visible face at pixel v of scan line u; -1 for none, -2 outside the image."""
    if v < 0 or v >= length:
        return -2
    row, column = place(axis, u, v, face_index.shape[1])
    return face_index[b, row, column]
