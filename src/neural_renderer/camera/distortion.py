"""Lens models: where lenses show points on the plane at depth 1, and the inverse.

A model of `Camera` is a `LensModel`: two functions, and the number of its coefficients, by which `lens_model` finds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..raster.ops.project_corners import LEAST_DEPTH

Point = tuple[Tensor, Tensor]

_FARTHEST = 1e9  # bound of |x| and |y| in tangential distortion
_WIDEST = 1e4  # bound of x² + y² in the radial polynomial: 89.4° from the optical axis
_STEPS = 10  # Newton's method; each step doubles the correct digits


@dataclass(frozen=True)
class LensModel:
    """A lens with distortion.

    Attributes:
        name: Name in messages.
        coefficients: Their number C.
        project: Function of camera coordinates [..., V, 3], coefficients [..., C] and the number that is added to the
            depth; returns x and y, [..., V] each, to which K is applied.
        unproject: Function of x and y, [B, V] each, and coefficients [B, C]; returns x and y of points at depth 1.
        shows_behind: Whether a point behind the camera stays on its side of the image, unlike behind a pinhole.
    """

    name: str
    coefficients: int
    project: Callable[[Tensor, Tensor, float], Point]
    unproject: Callable[[Tensor, Tensor, Tensor], Point]
    shows_behind: bool = False


def lens_model(dist_coeffs: Tensor | None) -> LensModel | None:
    """Return the model that has this number of coefficients; None for a pinhole."""
    return None if dist_coeffs is None else _BY_COUNT.get(dist_coeffs.shape[-1] if dist_coeffs.ndim else 0)


def pinhole(points: Tensor, eps: float = 0.0) -> Point:
    """Divide camera coordinates [..., V, 3] by their depth plus ``eps``. Results and gradients are finite."""
    near = away_from_zero(points[..., 2] + eps)
    return points[..., 0] / near, points[..., 1] / near


def away_from_zero(z: Tensor) -> Tensor:
    """Move z to at least `LEAST_DEPTH` from 0, keeping its sign, so that 1 / z and its gradient are finite."""
    return torch.where(z.abs() < LEAST_DEPTH, torch.where(z < 0, -LEAST_DEPTH, LEAST_DEPTH).to(z.dtype), z)


# Brown (1966) and Conrady (1919), as in OpenCV's `projectPoints`.


def distorted(x: Tensor, y: Tensor, dist_coeffs: Tensor) -> Point:
    """Distort coordinates [..., V] at depth 1 (step 3 of `projection`) by (k1, k2, p1, p2, k3) [..., 5]."""
    k1, k2, p1, p2, k3 = dist_coeffs[..., None].unbind(-2)
    # Squares and r⁶ would overflow for points at the camera's plane, which no image shows.
    a, b = x.clamp(-_FARTHEST, _FARTHEST), y.clamp(-_FARTHEST, _FARTHEST)
    r2 = a * a + b * b
    bounded = r2.clamp(max=_WIDEST)
    radial = 1 + bounded * (k1 + bounded * (k2 + bounded * k3))
    return (
        x * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a),
        y * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b,
    )


def undistorted(u: Tensor, v: Tensor, dist_coeffs: Tensor) -> Point:
    """Find the x and y [B, V] that `distorted` moves to u and v, by Newton's method."""
    k1, k2, p1, p2, k3 = dist_coeffs.detach()[..., None].unbind(-2)
    x, y = torch.broadcast_tensors(u.detach(), v.detach() + 0 * k1)
    for step in range(_STEPS):
        r2 = x * x + y * y
        radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + 3 * r2 * k3)
        # The symmetric Jacobian of `distorted`.
        du_dy = 2 * (x * y * slope + p1 * x + p2 * y)
        du_dx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        dv_dy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        determinant = du_dx * dv_dy - du_dy * du_dy
        # Only the last step has gradients. It starts at the solution, where the derivative of one step of Newton's
        # method is that of the inverse function.
        is_last = step == _STEPS - 1
        target_u, target_v = (u, v) if is_last else (u.detach(), v.detach())
        found_u, found_v = distorted(x, y, dist_coeffs if is_last else dist_coeffs.detach())
        error_u, error_v = found_u - target_u, found_v - target_v
        x = x - (dv_dy * error_u - du_dy * error_v) / determinant
        y = y - (du_dx * error_v - du_dy * error_u) / determinant
    return x, y


# Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye lenses"
# (2006), equation 6, with the coefficients of OpenCV's `cv2.fisheye`.


def fisheye(points: Tensor, coefficients: Tensor) -> Point:
    """Project camera coordinates [..., V, 3] with (k1, k2, k3, k4) [..., 4]: x and y, [..., V] each.

    The angle runs up to π, so that points behind the camera stay outside of the image. Values and gradients are finite,
    also on the axis.
    """
    # The result depends on the direction only. Scaled to a largest coordinate of 1, its squares do not overflow.
    x, y, z = (points / points.detach().abs().amax(-1, keepdim=True).clamp(min=LEAST_DEPTH)).unbind(-1)
    radius = (x * x + y * y).clamp(min=torch.finfo(points.dtype).eps).sqrt()  # θ / radius is 1 / z on the axis
    scale = _fisheye_radius(torch.atan2(radius, z), coefficients) / radius
    return x * scale, y * scale


def undo_fisheye(u: Tensor, v: Tensor, coefficients: Tensor) -> Point:
    """Find x and y at depth 1 of the points that `fisheye` moves to u and v, all [B, V], by Newton's method."""
    target = (u * u + v * v).clamp(min=torch.finfo(u.dtype).eps).sqrt() + 0 * coefficients[..., :1]
    theta = target.detach().clamp(max=math.pi / 2)
    for step in range(_STEPS):
        is_last = step == _STEPS - 1  # the only step with gradients, as in `undistorted`
        slope = _fisheye_slope(theta, coefficients.detach())
        found = _fisheye_radius(theta, coefficients if is_last else coefficients.detach())
        theta = theta - (found - (target if is_last else target.detach())) / slope
    scale = torch.tan(theta) / target
    return u * scale, v * scale


def _fisheye_radius(theta: Tensor, coefficients: Tensor) -> Tensor:
    """Compute the distance from the axis, [..., V], of points at angles θ from it."""
    k1, k2, k3, k4 = coefficients[..., None].unbind(-2)
    t2 = theta * theta
    return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def _fisheye_slope(theta: Tensor, coefficients: Tensor) -> Tensor:
    """Compute the derivative of `_fisheye_radius`."""
    k1, k2, k3, k4 = coefficients[..., None].unbind(-2)
    t2 = theta * theta
    return 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))


BROWN_CONRADY = LensModel("K with distortion", 5, lambda p, k, eps: distorted(*pinhole(p, eps), k), undistorted)
KANNALA_BRANDT = LensModel("fisheye", 4, lambda p, k, _: fisheye(p, k), undo_fisheye, shows_behind=True)
_BY_COUNT = {model.coefficients: model for model in (BROWN_CONRADY, KANNALA_BRANDT)}
