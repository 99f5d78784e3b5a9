"""Tangential smoothing: vertices move along the surface towards the middle of their neighbours."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from .edges import Edges, area_vectors
from .surface import Surface

_LEAST_COSINE = 0.5  # least cosine between a face's normals before and after
_LEAST_AREA = 0.1  # least area of a face afterwards, relative to before


def relax(surface: Surface, strength: float = 0.5) -> Surface:
    """Move vertices along the surface, without turning faces over.

    Args:
        surface: The mesh.
        strength: How far, in (0, 1]: 1 is all the way to the mean of the neighbours.

    Returns:
        The mesh, with the same faces. Vertices at borders stay.
    """
    vertices, faces = surface.vertices, surface.faces
    edges = Edges.of(faces, len(vertices))
    a, b = edges.ends.unbind(1)
    total = torch.zeros_like(vertices).index_add(0, a, vertices[b]).index_add(0, b, vertices[a])
    offset = total / edges.valence().clamp(min=1)[:, None] - vertices
    facing = area_vectors(vertices[faces])
    normal = torch.zeros_like(vertices).index_add(0, faces.flatten(), facing.repeat_interleave(3, 0))
    normal = normalize(normal, dim=1)
    offset = strength * (offset - (offset * normal).sum(1, keepdim=True) * normal)
    return surface.moved(move_safely(vertices, vertices + offset * ~edges.fixed[:, None], faces))


def move_safely(vertices: Tensor, goal: Tensor, faces: Tensor) -> Tensor:
    """Move vertices [V, 3] to ``goal``, except where faces [F, 3] would turn over or shrink to slivers."""
    before = area_vectors(vertices[faces])
    size = before.norm(dim=1)
    while True:
        now = area_vectors(goal[faces])
        wrong = (before * now).sum(1) < size * torch.maximum(_LEAST_COSINE * now.norm(dim=1), _LEAST_AREA * size)
        wrong &= (goal[faces] != vertices[faces]).flatten(1).any(1)
        if not bool(wrong.any()):
            return goal
        rows = faces[wrong].flatten()
        goal = goal.index_copy(0, rows, vertices[rows])
