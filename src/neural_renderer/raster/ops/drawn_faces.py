"""Selection of drawn faces, and the terms of their depth, for all kernels of `coverage`."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import facing, homogeneous_weights, in_front, pixel_centre

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def crossing_depth(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, i: int, j: int, height: int, width: int) -> float:
    """Compute the depth at a pixel of a face that crosses the camera's plane; 0 outside the face."""
    a = homogeneous_weights(v0, v1, v2, pixel_centre(i, width), pixel_centre(j, height))
    if a[0] >= wp.float64(0.0) and a[1] >= wp.float64(0.0) and a[2] >= wp.float64(0.0):
        return float(wp.float64(1.0) / (a[0] + a[1] + a[2]))
    return 0.0


_NEXT_CANDIDATE = """
    const wp::int64 count = faces.shape[1];
    for (; f < count; ++f) {
        const wp::vec_t<3, float>* v = faces.data + (b * count + f) * 3;
        const float x0 = v[0][0], x1 = v[1][0], x2 = v[2][0], y0 = v[0][1], y1 = v[1][1], y2 = v[2][1];
        const float z0 = v[0][2], z1 = v[1][2], z2 = v[2][2];
        if (perspective && !((z0 > 0.0f) & (z1 > 0.0f) & (z2 > 0.0f))) break;
        const bool below = (y0 < low) & (y1 < low) & (y2 < low), above = (y0 > high) & (y1 > high) & (y2 > high);
        const bool close = (z0 <= near) & (z1 <= near) & (z2 <= near), away = (z0 >= far) & (z1 >= far) & (z2 >= far);
        const float left = (y2 - y0) * (x1 - x0), right = (y1 - y0) * (x2 - x0);
        if (!(below | above | close | away) & (two_sided ? left != right : left > right)) break;
    }
    return f;
"""


@wp.func_native(_NEXT_CANDIDATE)
def next_candidate(
    faces: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    low: float,
    high: float,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
) -> int:
    """Find the first face from f on that may be drawn (see `drawn_face`); return the number of faces if none."""
    ...


@wp.func
def drawn_face(
    faces: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    low: float,
    high: float,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
    """Classify a face (see `in_front`; -1 if it is not drawn between two heights) and orient it counter-clockwise.

    Returns the class, the index (plus the number of faces for a back side) and the three corners.
    """
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    index = int(f)
    front = in_front(v0, v1, v2, perspective)
    if front == 1:
        # Most faces are skipped here: above, below, too near or too far.
        if wp.max(v0[1], wp.max(v1[1], v2[1])) < low or wp.min(v0[1], wp.min(v1[1], v2[1])) > high:
            front = -1
        if wp.max(v0[2], wp.max(v1[2], v2[2])) <= near or wp.min(v0[2], wp.min(v1[2], v2[2])) >= far:
            front = -1
    if front >= 0:
        side = facing(v0, v1, v2, perspective)
        if side == 0 or (side < 0 and two_sided == 0):
            front = -1
        if side < 0:
            # The first packages append reversed copies after all faces. Ties are decided in the same order here: if a
            # file contains a face twice, once reversed, both have the same depth to the last bit.
            index = f + faces.shape[1]
            v0, v2 = v2, v0
    return front, index, v0, v1, v2


@wp.func
def depth_terms(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int):
    """Compute the vectors n and d of the depth (e . n) / (e . d) for edge functions e."""
    n = wp.vec3(v0[2], v1[2], v2[2])
    d = wp.vec3(1.0, 1.0, 1.0)
    if perspective == 1:
        n = wp.vec3(1.0, 1.0, 1.0)
        d = wp.vec3(1.0 / v0[2], 1.0 / v1[2], 1.0 / v2[2])
    return n, d
