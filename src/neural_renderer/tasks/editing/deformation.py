"""How a mesh has changed its shape, as numbers that losses can use."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ... import losses
from ...meshes.topology import Topology


@dataclass(frozen=True, eq=False)
class Deformation:
    """A mesh that was moved.

    Attributes:
        vertices: [V, 3], where they are.
        start: [V, 3], where they were.
        topology: the mesh's.
    """

    vertices: Tensor
    start: Tensor
    topology: Topology

    @property
    def movement(self) -> Tensor:
        """[V, 3], from the start to now."""
        return self.vertices - self.start

    @property
    def edge(self) -> Tensor:
        """[], the mean squared length of the edges at the start."""
        return losses.edge_length(self.start, self.topology).clamp(min=1e-12)

    @property
    def bend(self) -> Tensor:
        """[], the mean over the edges of the squared change (as a vector) over the squared length at the start.

        It is 0 for a mesh that was shifted as a whole and large for one with creases and spikes that were not there,
        as much where the faces are small as where they are large.
        """
        before, change = (values[self.topology.edges].diff(dim=1) for values in (self.start, self.movement))
        length = before.square().sum((1, 2)).clamp(min=0.01 * float(self.edge))
        return (change.square().sum((1, 2)) / length).mean()

    @property
    def edge_variance(self) -> Tensor:
        """[], the variance of the edges' lengths."""
        ends = self.vertices[self.topology.edges]
        return (ends[:, 0] - ends[:, 1]).norm(dim=1).var(unbiased=False)
