"""Bounding boxes."""

from __future__ import annotations

from torch import Tensor


def bounding_box(points: Tensor) -> tuple[Tensor, float]:
    """Compute the axis-aligned bounding box of points.

    Args:
        points: [..., D] floating, at least one point.

    Returns:
        The centre of the box, [D], and half the length of its longest side.
    """
    flat = points.reshape(-1, points.shape[-1])
    low, high = flat.amin(0), flat.amax(0)
    return (low + high) / 2, float((high - low).max()) / 2
