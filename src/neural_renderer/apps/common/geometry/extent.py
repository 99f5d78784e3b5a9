"""Extent of a mesh, with limits."""

from __future__ import annotations

from torch import Tensor

from ....meshes.bounds import bounding_box

_LONGEST = 1e15  # side of a mesh whose square, and the inverse of it, are well within float32


def extent(points: Tensor) -> tuple[Tensor, float]:
    """Compute the `bounding_box` of a mesh; ValueError unless squares of its sides fit float32."""
    center, half = bounding_box(points)
    if half == 0:
        raise ValueError("mesh: expected a mesh with an extent, got faces whose vertices all coincide")
    if not 1 / _LONGEST <= 2 * half <= _LONGEST:
        raise ValueError(f"mesh: expected a longest side from {1 / _LONGEST:g} to {_LONGEST:g} units, got {2 * half:g}")
    return center, half
