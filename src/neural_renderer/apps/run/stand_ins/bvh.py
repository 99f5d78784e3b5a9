"""The interface of cumesh's `cuBVH`: closest points. An independent implementation."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...common.geometry.closest_points import closest_points


class cuBVH:
    """Closest points of a mesh with vertices [V, 3] and triangles [F, 3]."""

    def __init__(self, vertices: Any, triangles: Any) -> None:
        self._vertices, self._faces = torch.as_tensor(vertices).float(), torch.as_tensor(triangles).long()

    def unsigned_distance(self, positions: Tensor, return_uvw: bool = False) -> tuple[Tensor, Tensor, Tensor | None]:
        """Find distances [...], faces [...] and optionally weights [..., 3] of the closest points."""
        points = positions.reshape(-1, 3).float()
        found = closest_points((self._vertices, self._faces), points)
        shape = positions.shape[:-1]
        distance = (found.points - points).norm(dim=1).view(shape)
        weights = found.weights.view(*shape, 3) if return_uvw else None
        return distance, found.face_index.view(shape), weights

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"cuBVH: expected unsigned_distance, got {name}, which is not here")
