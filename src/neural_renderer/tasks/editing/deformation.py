"""`Deformation`: the movement of a mesh's vertices, and losses on it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ... import losses
from ...meshes.topology import Topology


@dataclass(frozen=True, eq=False)
class Deformation:
    """A mesh and its initial shape."""

    vertices: Tensor  # [V, 3], current positions
    start: Tensor  # [V, 3], initial positions
    topology: Topology

    @property
    def movement(self) -> Tensor:
        """Displacements of the vertices, [V, 3]."""
        return self.vertices - self.start

    @property
    def edge(self) -> Tensor:
        """Mean squared edge length of the initial shape, scalar."""
        return losses.edge_length(self.start, self.topology).clamp(min=1e-12)

    @property
    def bend(self) -> Tensor:
        """Mean over edges of the squared change of the edge vector, relative to the squared initial length; scalar.

        It is 0 for a translation and large for new creases and spikes. Small faces count as much as large ones.
        """
        before, change = (values[self.topology.edges].diff(dim=1) for values in (self.start, self.movement))
        length = before.square().sum((1, 2)).clamp(min=0.01 * float(self.edge))
        return (change.square().sum((1, 2)) / length).mean()

    @property
    def edge_variance(self) -> Tensor:
        """Variance of the edge lengths, scalar."""
        ends = self.vertices[self.topology.edges]
        return (ends[:, 0] - ends[:, 1]).norm(dim=1).var(unbiased=False)
