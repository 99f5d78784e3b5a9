"""Which edges a mesh has, and which two faces meet at each."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .. import validate


@dataclass(frozen=True, eq=False)
class Topology:
    """The edges of a mesh, found once by `Topology.of` and used in place of ``faces`` by the losses that need them.

    A face that names a vertex twice has no part in it.
    Build it outside of torch.compile: how many edges there are depends on the numbers in ``faces``.

    Attributes:
        edges: [E, 2] int64, each edge once, smaller vertex index first, sorted.
        hinges: [I, 4] int64, (v0, v1, v2, v3) for each pair of faces that meet at an edge (v0, v1), where v2 and v3 are
            the corners opposite to it in the two faces. An edge of one face has none, an edge of k faces k − 1.
        vertices: the least number of vertices the mesh can have: the largest index + 1.
    """

    edges: Tensor
    hinges: Tensor
    vertices: int

    @classmethod
    def of(cls, faces: Tensor) -> Topology:
        """From faces [F, 3], whole numbers of any real dtype, in O(F log F).

        Raises TypeError or ValueError for another dtype or shape, ValueError for a negative index.
        """
        faces = validate.has_numbers("faces", validate.indices("faces", faces, ("F", 3))).long()
        count = int(faces.max()) + 1 if len(faces) else 0
        validate.in_range("faces", faces, max(count, 1))
        faces = faces[(faces != faces.roll(1, dims=1)).all(1)]
        sides = torch.cat((faces, faces.roll(-1, dims=1), faces.roll(-2, dims=1)))  # (start, end, opposite)
        low, high = sides[:, :2].amin(1), sides[:, :2].amax(1)
        key, order = torch.sort(low * count + high, stable=True)  # the sides of one edge become neighbours
        low, high, opposite = low[order], high[order], sides[order, 2]
        again = torch.zeros_like(key, dtype=torch.bool)
        again[1:] = key[1:] == key[:-1]
        second = torch.nonzero(again).squeeze(1)
        first = second - 1
        return cls(
            edges=torch.stack((low, high), dim=1)[~again],
            hinges=torch.stack((low[first], high[first], opposite[first], opposite[second]), dim=1),
            vertices=count,
        )

    def to(self, device: torch.device | str) -> Topology:
        """The same topology on another device."""
        return Topology(self.edges.to(device), self.hinges.to(device), self.vertices)
