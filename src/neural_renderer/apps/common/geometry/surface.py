"""`Surface`: the mesh during remeshing, whose vertices carry values."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from torch import Tensor

from ....meshes.pieces import used_vertices
from .edges import Edges


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh whose vertices carry values: positions, target lengths and attributes in one tensor."""

    values: Tensor  # [V, 4 + C] floating: position, target length of the edges around, attributes
    faces: Tensor  # [F, 3] int64

    @property
    def vertices(self) -> Tensor:
        """Positions, [V, 3]."""
        return self.values[:, :3]

    @property
    def target(self) -> Tensor:
        """Target length of the edges around each vertex, [V]."""
        return self.values[:, 3]

    @functools.cached_property
    def edges(self) -> Edges:
        """The edges of the faces."""
        return Edges.of(self.faces, len(self.values))

    def target_of(self, ends: Tensor) -> Tensor:
        """Average the target lengths at the ends [E, 2] of edges, [E]."""
        return self.target[ends].mean(1)

    def moved(self, vertices: Tensor) -> Surface:
        """Replace the positions."""
        return self.with_values(torch.cat((vertices, self.values[:, 3:]), 1))

    def with_values(self, values: Tensor) -> Surface:
        """Replace all values of the vertices; cached edges are kept."""
        surface = Surface(values, self.faces)
        if "edges" in self.__dict__:
            surface.__dict__["edges"] = self.edges
        return surface

    def compact(self) -> Surface:
        """Remove the vertices that no face uses."""
        rows, faces = used_vertices(self.faces)
        return Surface(self.values[rows], faces)
