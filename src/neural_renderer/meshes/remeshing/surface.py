"""The mesh that remeshing works on: vertices with values that are carried along."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..pieces import used_vertices


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh whose vertices carry values: positions, target lengths and attributes in one tensor.

    Attributes:
        values: [V, 4 + C] floating: position, target length of the edges around, attributes.
        faces: [F, 3] int64.
    """

    values: Tensor
    faces: Tensor

    @property
    def vertices(self) -> Tensor:
        """Positions, [V, 3]."""
        return self.values[:, :3]

    @property
    def target(self) -> Tensor:
        """Target length of the edges around each vertex, [V]."""
        return self.values[:, 3]

    def target_of(self, ends: Tensor) -> Tensor:
        """Average the target lengths at the ends [E, 2] of edges, [E]."""
        return self.target[ends].mean(1)

    def moved(self, vertices: Tensor) -> Surface:
        """Replace the positions."""
        return Surface(torch.cat((vertices, self.values[:, 3:]), 1), self.faces)

    def compact(self) -> Surface:
        """Drop the vertices that no face uses."""
        rows, faces = used_vertices(self.faces)
        return Surface(self.values[rows], faces)
