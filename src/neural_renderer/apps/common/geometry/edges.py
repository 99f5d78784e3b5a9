"""Edges of a triangle mesh with their faces, and its connected components, for the operations of remeshing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of a mesh.

    A regular edge has exactly two faces, of equal orientation. Other edges are boundaries, are non-manifold, or
    join faces of different orientation.
    """

    keys: Tensor  # [E] int64, ascending: lower vertex index · number of vertices + higher index
    ends: Tensor  # [E, 2] int64, lower vertex index first
    sides: Tensor  # [F, 3] int64, the edge from each corner of a face to the next one
    faces: Tensor  # [E, 2] int64, two faces of each edge; only valid where ``regular``
    opposite: Tensor  # [E, 2] int64, the third vertices of ``faces``; only valid where ``regular``
    regular: Tensor  # [E] bool
    fixed: Tensor  # [V] bool, vertices at edges that are not regular

    @classmethod
    def of(cls, faces: Tensor, count: int) -> Edges:
        """Find the edges of faces [F, 3] int64 with ``count`` vertices."""
        start, end = faces.flatten(), faces.roll(-1, 1).flatten()
        keys, order = torch.sort(torch.minimum(start, end) * count + torch.maximum(start, end), stable=True)
        is_first = torch.ones_like(keys, dtype=torch.bool)
        is_first[1:] = keys[1:] != keys[:-1]
        first = torch.nonzero(is_first)[:, 0]
        number = torch.diff(first, append=first.new_tensor([len(keys)]))
        sides = torch.empty_like(order).scatter_(0, order, is_first.cumsum(0) - 1)
        half_edges = order[
            torch.stack((first, (first + 1).clamp(max=max(len(keys) - 1, 0))), 1)
        ]  # two half-edges of each edge
        regular = (number == 2) & (start[half_edges[:, 0]] == end[half_edges[:, 1]])
        keys = keys[first]
        ends = torch.stack((keys // count, keys % count), 1)
        fixed = torch.zeros(count, dtype=torch.bool, device=faces.device)
        fixed[ends[~regular].flatten()] = True
        opposite = faces.roll(-2, 1).flatten()[half_edges]
        return cls(keys, ends, sides.view(-1, 3), half_edges // 3, opposite, regular, fixed)

    def contain(self, keys: Tensor) -> Tensor:
        """Return which keys [N] are edges, [N] bool."""
        position = torch.searchsorted(self.keys, keys).clamp(max=len(self.keys) - 1)
        return self.keys[position] == keys

    def valence(self) -> Tensor:
        """Count the edges of each vertex, [V] int64."""
        return torch.bincount(self.ends.flatten(), minlength=len(self.fixed))


def area_vectors(corners: Tensor) -> Tensor:
    """Compute outward normals [F, 3], twice as long as the area, of counter-clockwise faces [F, 3 corners, 3]."""
    return torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], dim=1)


def areas(corners: Tensor) -> Tensor:
    """Compute the areas [F] of faces [F, 3 corners, 3]."""
    return area_vectors(corners).norm(dim=1) / 2


def lengths(vertices: Tensor, ends: Tensor) -> Tensor:
    """Compute the lengths [E] of edges [E, 2]."""
    return (vertices[ends[:, 0]] - vertices[ends[:, 1]]).norm(dim=1)


def connected_components(faces: Tensor) -> Tensor:
    """Number the connected components of a mesh: the component [F] int64 of each face [F, 3]."""
    from scipy import sparse  # imported here because it takes 0.1 s
    from scipy.sparse import csgraph

    corners = faces.cpu().numpy()
    ends = np.concatenate((corners[:, :2], corners[:, 1:]))
    graph = sparse.coo_matrix((np.ones(len(ends), bool), tuple(ends.T)), shape=(int(corners.max()) + 1,) * 2)
    component = csgraph.connected_components(graph, directed=False)[1]
    return torch.from_numpy(component[corners[:, 0]]).to(faces)
