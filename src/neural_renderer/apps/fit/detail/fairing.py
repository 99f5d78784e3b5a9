"""Fairing: faces turn towards neighbours of nearly their direction, so that noise goes, and creases stay."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...common.geometry.edges import area_vectors
from ...common.geometry.surface import Surface

_ANGLE = 0.2  # radians between adjacent faces that count as a crease: their weight is exp(-1/2)
_ROUNDS, _FOLLOW = 6, 2  # averages of normals, and steps in which vertices follow them


def faired(surface: Surface, share: float) -> Tensor:
    """Compute fairer vertices [V, 3].

    Normals are filtered after Zheng and others, "Bilateral normal filtering for mesh denoising" (2011), eq. 3; vertices
    follow after Sun and others, "Fast and effective feature-preserving mesh denoising" (2007), eq. 5, by a ``share``.
    """
    vertices, faces, edges = surface.vertices, surface.faces, surface.edges
    a, b = edges.faces[edges.regular].unbind(1)
    areas = area_vectors(vertices[faces])
    sizes = areas.norm(dim=1, keepdim=True)
    normals = F.normalize(areas, dim=1)
    for _ in range(_ROUNDS):
        alike = torch.exp((normals[a] - normals[b]).square().sum(1, keepdim=True) / (-2 * _ANGLE**2))
        total = (sizes * normals).index_add(0, a, alike * sizes[b] * normals[b])
        normals = F.normalize(total.index_add(0, b, alike * sizes[a] * normals[a]), dim=1)
    corners = faces.flatten()
    share_of = share / torch.bincount(corners, minlength=len(vertices)).clamp(min=1)[:, None]
    for _ in range(_FOLLOW):
        places = vertices[faces]
        height = ((places.mean(1, keepdim=True) - places) * normals[:, None]).sum(2, keepdim=True)
        moves = torch.zeros_like(vertices).index_add(0, corners, (height * normals[:, None]).flatten(0, 1))
        vertices = vertices + share_of * moves
    return vertices
