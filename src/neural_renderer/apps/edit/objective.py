"""`Objective`: a loss on the images of an edited mesh and on its `Deformation`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ...meshes.topology import Topology
from ...optim import losses


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


class Objective(Protocol):
    """Loss on the images of an edited mesh: `Style` or `Dream`."""

    name: str  # name of the main loss
    plain: Tensor  # [3], initial colour of a mesh without colours

    def background(self, count: int, generator: torch.Generator, /) -> Tensor:
        """Choose the background colours behind the object.

        Args:
            count: Number of images.
            generator: Random numbers, on the CPU.

        Returns:
            [count, 3].
        """
        ...

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation, /) -> dict[str, Tensor]:
        """Compute the losses.

        Args:
            images: [B, 3, H, W] in [0, 1].
            masks: [B, H, W] in [0, 1], silhouettes of the object.
            shape: Deformation of the mesh.

        Returns:
            Weighted losses by name, scalars; their sum is to be minimised.

        Raises:
            TypeError, ValueError: The images do not fit or are too small for a layer.
        """
        ...

    def measure(self, images: Tensor, masks: Tensor, /) -> Tensor:
        """Compute the main measure of each image.

        Args:
            images, masks: As in `losses`.

        Returns:
            [B], without a gradient.

        Raises:
            TypeError, ValueError: As `losses`.
        """
        ...
