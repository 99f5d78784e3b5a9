"""Fisheye lenses: OpenCV's model with four coefficients, and its inverse."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..raster.ops.project_corners import LEAST_DEPTH

_STEPS = 10  # Newton's method; each step doubles the correct digits


def fisheye(points: Tensor, coefficients: Tensor) -> tuple[Tensor, Tensor]:
    """Project camera coordinates [..., V, 3] with a lens as of `Camera.fisheye` to x and y at depth 1, [..., V] each.

    The coefficients [..., 4] are (k1, k2, k3, k4). The angle runs up to π, so that points behind the camera stay
    outside of the image. Values and gradients are finite, also on the axis.
    """
    # Only the direction matters. Scaled to a longest side of 1, its squares neither overflow nor vanish.
    x, y, z = (points / points.detach().abs().amax(-1, keepdim=True).clamp(min=LEAST_DEPTH)).unbind(-1)
    across = (x * x + y * y).clamp(min=torch.finfo(points.dtype).eps).sqrt()  # θ / across is 1 / z on the axis
    stretch = _distance(torch.atan2(across, z), coefficients) / across
    return x * stretch, y * stretch


def undo_fisheye(u: Tensor, v: Tensor, coefficients: Tensor) -> tuple[Tensor, Tensor]:
    """Find x and y at depth 1 of the points that `fisheye` moves to u and v, all [B, V], by Newton's method."""
    target = (u * u + v * v).clamp(min=torch.finfo(u.dtype).eps).sqrt() + 0 * coefficients[..., :1]
    theta = target.detach().clamp(max=math.pi / 2)
    for step in range(_STEPS):
        # The last step carries the gradients: θ is a solution, so that one step differentiates it exactly.
        is_last = step == _STEPS - 1
        slope = _slope(theta, coefficients.detach())
        found = _distance(theta, coefficients if is_last else coefficients.detach())
        theta = theta - (found - (target if is_last else target.detach())) / slope
    stretch = torch.tan(theta) / target
    return u * stretch, v * stretch


def _distance(theta: Tensor, coefficients: Tensor) -> Tensor:
    """Compute the distance from the axis, [..., V], of points at the angles θ."""
    k1, k2, k3, k4 = coefficients[..., None].unbind(-2)
    t2 = theta * theta
    return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def _slope(theta: Tensor, coefficients: Tensor) -> Tensor:
    """Compute the derivative of `_distance`."""
    k1, k2, k3, k4 = coefficients[..., None].unbind(-2)
    t2 = theta * theta
    return 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
