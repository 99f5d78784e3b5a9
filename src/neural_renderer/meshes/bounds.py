"""Bounding boxes, and normalisation of vertices to a box."""

from __future__ import annotations

from torch import Tensor

from ..base import validate


def bounding_box(points: Tensor) -> tuple[Tensor, float]:
    """Compute the bounding box of points [..., D]: return its centre [D], and half the length of its longest side."""
    flat = points.reshape(-1, points.shape[-1])
    low, high = flat.amin(0), flat.amax(0)
    return (low + high) / 2, float((high - low).max()) / 2


def centered(vertices: Tensor) -> Tensor:
    """Move and scale vertices [V, 3] into [−1, 1], in float64; see `Mesh.normalize`."""
    vertices = validate.vertices(validate.has_numbers("vertices", vertices)).double()
    center, half = bounding_box(vertices.detach())
    if half == 0:
        raise ValueError(f"vertices: expected vertices that differ, got {len(vertices)} that all coincide")
    return (vertices - center) / half
