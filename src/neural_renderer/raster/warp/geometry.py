"""A face on the pixel grid: what the kernels of all operations share.

Screen space: a corner is ``(x, y, z)``, x to the right and y up in [-1, 1] over the image, z the depth along the
viewing axis. Pixel units: ``u = (size * x + size - 1) / 2``, so that pixel centres are the integers; rows count from
the bottom. Maps in memory have row 0 at the top.

A face some of whose corners lie behind the camera (z <= 0) still has a visible part. With ``a_k = w_k / z_k`` for the
(extrapolated) screen-space weights ``w_k``, a pixel shows the face where all ``a_k >= 0``, at depth ``1 / sum(a_k)``:
the homogeneous form of the same test, so nothing needs to be clipped (Olano and Greer, "Triangle scan conversion using
2D homogeneous coordinates", 1997).
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

# Corners beyond have no products in float32.
FARTHEST = wp.constant(1.0e12)
# Screen units: four roundings of a coordinate near 1. What changes within less is not known.
NARROWEST = wp.constant(2.0**-22)
# Pixels: of an edge that crosses less of them no slope is computed. Float32 tells so little only in one pixel's line.
SHORTEST = wp.constant(1.0e-9)
Int4 = wp.types.vector(length=4, dtype=wp.int32)


@wp.func
def pixel_centre(i: int, size: int) -> float:
    """The screen coordinate of the centre of pixel ``i``."""
    return float(2 * i + 1 - size) / float(size)


@wp.func
def to_pixels(x: float, size: int) -> float:
    return 0.5 * (float(size) * x + float(size - 1))


@wp.func
def facing(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int) -> int:
    """1 if the corners run counter-clockwise on the screen, -1 if clockwise, 0 if they are on one line."""
    left = (v2[1] - v0[1]) * (v1[0] - v0[0])
    right = (v1[1] - v0[1]) * (v2[0] - v0[0])
    side = int(0)
    if left > right:
        side = 1
    if left < right:
        side = -1
    if perspective == 1:
        # Each corner behind the camera turns the projected triangle over.
        if v0[2] <= 0.0:
            side = -side
        if v1[2] <= 0.0:
            side = -side
        if v2[2] <= 0.0:
            side = -side
    return side


@wp.func
def degenerate(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3) -> bool:
    """Whether a weight changes by 1 over less than NARROWEST, along x or along y."""
    a = wp.abs(v2 - v1)
    b = wp.abs(v0 - v2)
    c = wp.abs(v1 - v0)
    longest = wp.max(wp.max(wp.max(a[0], a[1]), wp.max(b[0], b[1])), wp.max(c[0], c[1]))
    area = (v1[0] - v0[0]) * (v2[1] - v0[1]) - (v1[1] - v0[1]) * (v2[0] - v0[0])
    return wp.abs(area) <= NARROWEST * longest


@wp.func
def in_front(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int) -> int:
    """1 if the plain formulas hold, 0 if the face crosses the camera's plane, -1 if it cannot be drawn."""
    largest = wp.max(wp.max(wp.abs(v0)), wp.max(wp.max(wp.abs(v1)), wp.max(wp.abs(v2))))
    if not (wp.isfinite(v0) and wp.isfinite(v1) and wp.isfinite(v2)) or largest > FARTHEST:
        return -1
    if perspective == 0:
        return 1
    behind = int(0)
    if v0[2] <= 0.0:
        behind += 1
    if v1[2] <= 0.0:
        behind += 1
    if v2[2] <= 0.0:
        behind += 1
    if behind == 0:
        return 1
    if behind == 3:
        return -1
    # On the camera's plane itself the projection has no value.
    if v0[2] == 0.0 or v1[2] == 0.0 or v2[2] == 0.0:
        return -1
    return 0


@wp.func
def pixel_span(low: float, high: float, size: int, first: int, last: int) -> wp.vec2i:
    """The pixels of [first, last] whose centres can lie between two screen coordinates, rounding included."""
    a = wp.clamp(to_pixels(low, size) - 0.01, float(first), float(last + 1))
    b = wp.clamp(to_pixels(high, size) + 0.01, float(first - 1), float(last))
    return wp.vec2i(int(wp.ceil(a)), int(wp.floor(b)))


@wp.func
def pixel_box(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, front: int, height: int, width: int) -> Int4:
    """The pixels that a face can cover: first and last column, first and last row from the bottom."""
    if front != 1:
        return Int4(0, width - 1, 0, height - 1)
    x = pixel_span(wp.min(v0[0], wp.min(v1[0], v2[0])), wp.max(v0[0], wp.max(v1[0], v2[0])), width, 0, width - 1)
    y = pixel_span(wp.min(v0[1], wp.min(v1[1], v2[1])), wp.max(v0[1], wp.max(v1[1], v2[1])), height, 0, height - 1)
    return Int4(x[0], x[1], y[0], y[1])


@wp.func
def edge_double(a: wp.vec3, b: wp.vec3, x: float, y: float) -> wp.float64:
    px = wp.float64(x)
    py = wp.float64(y)
    return (wp.float64(a[0]) - px) * (wp.float64(b[1]) - py) - (wp.float64(a[1]) - py) * (wp.float64(b[0]) - px)


@wp.func
def homogeneous_weights(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float) -> wp.vec3d:
    """``a_k = w_k / z_k`` at a screen position; in double, because a corner near the camera's plane is far away."""
    e0 = edge_double(v1, v2, x, y)
    e1 = edge_double(v2, v0, x, y)
    e2 = edge_double(v0, v1, x, y)
    area = e0 + e1 + e2
    if area == wp.float64(0.0):
        return wp.vec3d(wp.float64(-1.0), wp.float64(-1.0), wp.float64(-1.0))
    return wp.vec3d(e0 / (area * wp.float64(v0[2])), e1 / (area * wp.float64(v1[2])), e2 / (area * wp.float64(v2[2])))
