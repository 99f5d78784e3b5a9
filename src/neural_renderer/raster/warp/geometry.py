"""Geometry of faces on the pixel grid, shared by the kernels of all operators.

Screen space: a corner is ``(x, y, z)``, x to the right and y up in [-1, 1] over the image, z the depth along the
viewing axis. Pixel units: ``u = (size * x + size - 1) / 2``, so that pixel centres are the integers; rows count from
the bottom. Maps in memory have row 0 at the top.

A face with some corners behind the camera (z <= 0) still has a visible part. With ``a_k = w_k / z_k`` for the
(extrapolated) screen-space weights ``w_k``, a pixel shows the face where all ``a_k >= 0``, at depth ``1 / sum(a_k)``.
This homogeneous form of the test needs no clipping (Olano and Greer, "Triangle scan conversion using 2D homogeneous
coordinates", 1997).
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

# Screen units: four roundings of a coordinate near 1, the resolution of float32.
NARROWEST = wp.constant(2.0**-22)
# An edge with a smaller extent across the scan lines, in pixels, has no slope. Float32 resolves such extents only near
# pixel 0.
SHORTEST = wp.constant(1.0e-9)
Int4 = wp.types.vector(length=4, dtype=wp.int32)


@wp.func
def pixel_centre(i: int, size: int) -> float:
    """Compute the screen coordinate of the centre of pixel ``i``."""
    return float(2 * i + 1 - size) / float(size)


@wp.func
def to_pixels(x: float, size: int) -> float:
    """Convert a screen coordinate to pixels, whose centres are the integers."""
    return 0.5 * (float(size) * x + float(size - 1))


# Plain C++, because every kernel tests every face, and Warp's loops over components are slow.
FACING = """
    const float left = (v2[1] - v0[1]) * (v1[0] - v0[0]), right = (v1[1] - v0[1]) * (v2[0] - v0[0]);
    const int side = (left > right) - (left < right);
    // Each corner behind the camera reverses the orientation of the projected triangle.
    const int behind = (v0[2] <= 0.0f) + (v1[2] <= 0.0f) + (v2[2] <= 0.0f);
    return perspective == 1 && (behind & 1) ? -side : side;
"""


@wp.func_native(FACING)
def facing(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int) -> int:
    """Compute the orientation on the screen: 1 counter-clockwise, -1 clockwise, 0 if the corners are collinear."""
    ...


@wp.func
def degenerate(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3) -> bool:
    """Test whether a weight changes by 1 over less than NARROWEST, along x or along y."""
    a = wp.abs(v2 - v1)
    b = wp.abs(v0 - v2)
    c = wp.abs(v1 - v0)
    longest = wp.max(wp.max(wp.max(a[0], a[1]), wp.max(b[0], b[1])), wp.max(c[0], c[1]))
    area = (v1[0] - v0[0]) * (v2[1] - v0[1]) - (v1[1] - v0[1]) * (v2[0] - v0[0])
    return wp.abs(area) <= NARROWEST * longest


IN_FRONT = """
    bool fits = true;
    for (int k = 0; k < 3; ++k)  // false for NaN, too
        fits &= (fabsf(v0[k]) <= 1.0e12f) & (fabsf(v1[k]) <= 1.0e12f) & (fabsf(v2[k]) <= 1.0e12f);
    if (!fits) return -1;
    const int behind = (v0[2] <= 0.0f) + (v1[2] <= 0.0f) + (v2[2] <= 0.0f);
    if (perspective == 0 || behind == 0) return 1;
    // A corner on the camera's plane has no projection.
    return behind == 3 || v0[2] == 0.0f || v1[2] == 0.0f || v2[2] == 0.0f ? -1 : 0;
"""


@wp.func_native(IN_FRONT)
def in_front(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int) -> int:
    """Classify a face: 1 in front of the camera, 0 across the camera's plane, -1 if it cannot be drawn.

    In orthographic projection every face is in front. Corners beyond 1e12 cannot be drawn, because their products
    overflow float32.
    """
    ...


@wp.func
def pixel_span(low: float, high: float, size: int, first: int, last: int) -> wp.vec2i:
    """Find the pixels of [first, last] whose centres may lie between two screen coordinates, despite rounding."""
    a = wp.clamp(to_pixels(low, size) - 0.01, float(first), float(last + 1))
    b = wp.clamp(to_pixels(high, size) + 0.01, float(first - 1), float(last))
    return wp.vec2i(int(wp.ceil(a)), int(wp.floor(b)))


@wp.func
def pixel_box(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, front: int, height: int, width: int) -> Int4:
    """Find the pixels that a face may cover: first and last column, first and last row from the bottom."""
    if front != 1:
        return Int4(0, width - 1, 0, height - 1)
    x = pixel_span(wp.min(v0[0], wp.min(v1[0], v2[0])), wp.max(v0[0], wp.max(v1[0], v2[0])), width, 0, width - 1)
    y = pixel_span(wp.min(v0[1], wp.min(v1[1], v2[1])), wp.max(v0[1], wp.max(v1[1], v2[1])), height, 0, height - 1)
    return Int4(x[0], x[1], y[0], y[1])


HOMOGENEOUS = """
    const wp::vec_t<3, float> v[3] = {v0, v1, v2};
    double e[3];
    for (int k = 0; k < 3; ++k) {
        const wp::vec_t<3, float> &a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
        e[k] = ((double)a[0] - x) * ((double)b[1] - y) - ((double)a[1] - y) * ((double)b[0] - x);
    }
    const double area = e[0] + e[1] + e[2];
    if (area == 0.0) return wp::vec_t<3, double>(-1.0, -1.0, -1.0);
    return wp::vec_t<3, double>(e[0] / (area * v0[2]), e[1] / (area * v1[2]), e[2] / (area * v2[2]));
"""


@wp.func_native(HOMOGENEOUS)
def homogeneous_weights(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float) -> wp.vec3d:
    """Compute ``a_k = w_k / z_k`` at a screen position; in double, for corners near the camera's plane."""
    ...
