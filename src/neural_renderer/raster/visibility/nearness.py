"""Nearness of a face: linear over the face on the screen, and larger in front.

In perspective the nearness of a point is ``1 / z``, in orthographic projection ``-z``. With screen-space barycentric
weights w_k it is ``sum(w_k n_k)`` over the corners' values n_k, so depths compare without a division at each point.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import homogeneous_weights

wp.set_module_options({"enable_backward": False})


@wp.func
def nearness(z: float, perspective: int) -> float:
    """Compute the nearness of a point of depth z."""
    if perspective == 1:
        return 1.0 / z
    return -z


@wp.func
def plane_nearness(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float, perspective: int) -> float:
    """Compute the nearness of a face's plane at a screen position, clamped to the range of the corners.

    Within one pixel, the plane of a face seen edge-on takes any value; hence the clamp. A face with a corner behind the
    camera is not clamped.
    """
    a = homogeneous_weights(v0, v1, v2, x, y)
    near = float(a[0] + a[1] + a[2])
    if perspective == 0:
        near = -float(a[0]) * v0[2] * v0[2] - float(a[1]) * v1[2] * v1[2] - float(a[2]) * v2[2] * v2[2]
    elif v0[2] <= 0.0 or v1[2] <= 0.0 or v2[2] <= 0.0:
        return near
    n0 = nearness(v0[2], perspective)
    n1 = nearness(v1[2], perspective)
    n2 = nearness(v2[2], perspective)
    return wp.clamp(near, wp.min(n0, wp.min(n1, n2)), wp.max(n0, wp.max(n1, n2)))


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
