"""Nearness of a face: linear over the face on the screen, and larger in front.

In perspective the nearness of a point is ``1 / z``, in orthographic projection ``-z``. With screen-space barycentric
weights w_k it is ``sum(w_k n_k)`` over the corners' values n_k, so depths compare without a division at each point.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import HOMOGENEOUS, homogeneous_weights
from ..warp.point import fill

wp.set_module_options({"enable_backward": False})


_NEARNESS = """
struct Nearness {
    typedef wp::vec_t<3, float> vec3;
    static CUDA_CALLABLE wp::vec_t<3, double> homogeneous(vec3 v0, vec3 v1, vec3 v2, float x, float y) { WEIGHTS }

    // Of a point of depth z.
    static CUDA_CALLABLE float of(float z, int perspective) { return perspective ? 1.0f / z : -z; }
    // Of the plane of a face at a screen position; the same as `nearness_terms` and `total`.
    static CUDA_CALLABLE float at(const vec3* v, float x, float y, int perspective) {
        const wp::vec_t<3, double> a = homogeneous(v[0], v[1], v[2], x, y);
        float part[3];
        for (int k = 0; k < 3; ++k) part[k] = perspective ? (float)a[k] : -((float)a[k] * v[k][2] * v[k][2]);
        return part[0] + part[1] + part[2];
    }
    // The same, clamped to the range of the corners: within a pixel, the plane of a face seen edge-on takes any value.
    // A face with a corner behind the camera is not clamped.
    static CUDA_CALLABLE float of_plane(const vec3* v, float x, float y, int perspective) {
        const float near = at(v, x, y, perspective);
        if (perspective && ((v[0][2] <= 0.0f) | (v[1][2] <= 0.0f) | (v[2][2] <= 0.0f))) return near;
        const float n[3] = {of(v[0][2], perspective), of(v[1][2], perspective), of(v[2][2], perspective)};
        return wp::min(wp::max(near, wp::min(n[0], wp::min(n[1], n[2]))), wp::max(n[0], wp::max(n[1], n[2])));
    }
};
"""
NEARNESS = fill(_NEARNESS, WEIGHTS=HOMOGENEOUS)  # for native functions


@wp.func
def nearness_terms(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float, perspective: int) -> wp.vec3:
    """Compute the corners' terms ``w_k n_k`` of a plane's nearness at a screen position."""
    a = homogeneous_weights(v0, v1, v2, x, y)
    if perspective == 1:
        return wp.vec3(float(a[0]), float(a[1]), float(a[2]))
    return -wp.vec3(float(a[0]) * v0[2] * v0[2], float(a[1]) * v1[2] * v1[2], float(a[2]) * v2[2] * v2[2])


@wp.func
def total(terms: wp.vec3) -> float:
    """Add the corners' terms: the nearness itself."""
    return terms[0] + terms[1] + terms[2]


@wp.func
def covers(terms: wp.vec3, perspective: int) -> bool:
    """Test whether the position with these nearness terms lies inside the face."""
    if perspective == 1:
        return terms[0] >= 0.0 and terms[1] >= 0.0 and terms[2] >= 0.0
    return terms[0] <= 0.0 and terms[1] <= 0.0 and terms[2] <= 0.0


@wp.func
def nearness_slope(
    v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float, here: float, pixel: wp.vec2, perspective: int
) -> wp.vec2:
    """Compute the change of a face's nearness over a pixel to the right and a pixel up; it is ``here`` at (x, y)."""
    right = total(nearness_terms(v0, v1, v2, x + pixel[0], y, perspective)) - here
    up = total(nearness_terms(v0, v1, v2, x, y + pixel[1], perspective)) - here
    return wp.vec2(right, up)
