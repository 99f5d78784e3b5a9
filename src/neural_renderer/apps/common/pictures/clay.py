"""Meshes of one colour, for pictures of shapes that have no texture."""

from __future__ import annotations

import torch
from torch import Tensor

from ....meshes.mesh import Mesh

CLAY = (0.55, 0.68, 0.84)
"""RGB of meshes without colours, a light blue."""


def plain_texture(faces: Tensor, color: tuple[float, float, float] = CLAY) -> Tensor:
    """Make a texture of one colour, [F, 1, 1, 1, 3], for faces [F, 3]."""
    return torch.tensor(color, device=faces.device).expand(len(faces), 1, 1, 1, 3)


def clay_mesh(vertices: Tensor, faces: Tensor, color: tuple[float, float, float] = CLAY) -> Mesh:
    """Make a mesh of one colour from vertices [V, 3] and faces [F, 3]."""
    return Mesh(vertices, faces, plain_texture(faces, color))
