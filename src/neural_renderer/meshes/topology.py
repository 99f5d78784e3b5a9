"""Edges of a mesh, and adjacent faces."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..base import validate
from ..raster.warp.registration import fake, operator


@dataclass(frozen=True, eq=False)
class Topology:
    """Edges and adjacent faces of a mesh, computed once by `Topology.of` and accepted by losses in place of ``faces``.

    A face with a repeated vertex index is ignored. ``hinges`` are (v0, v1, v2, v3) for each pair of faces with the
    common edge (v0, v1); v2 and v3 are the opposite corners. A boundary edge has no hinge; an edge of k faces has k −
    1.

    Example:
        >>> topology = Topology.of(torch.tensor([[0, 1, 2], [2, 1, 3]]))
        >>> topology.hinges.tolist()
        [[1, 2, 3, 0]]
    """

    edges: Tensor  # [E, 2] int64, each edge once, smaller vertex index first, sorted
    hinges: Tensor  # [I, 4] int64
    vertices: int  # largest vertex index + 1

    @classmethod
    def of(cls, faces: Tensor) -> Topology:
        """Find the edges of faces [F, 3], whole numbers of any real dtype; raise ValueError for a negative index."""
        faces = validate.has_numbers("faces", validate.indices("faces", faces, ("F", 3))).long()
        if torch.compiler.is_compiling():  # tracing cannot read values
            return cls(*edges_and_hinges(faces), vertices=0)
        count = int(faces.max()) + 1 if len(faces) else 0
        validate.in_range("faces", faces, max(count, 1))
        return cls(*edges_and_hinges(faces), vertices=count)

    def to(self, device: torch.device | str) -> Topology:
        """Copy the topology to another device."""
        return Topology(self.edges.to(device), self.hinges.to(device), self.vertices)


@operator
def edges_and_hinges(faces: Tensor) -> tuple[Tensor, Tensor]:
    """Find the edges and hinges of faces [F, 3] int64; see `Topology`."""
    count = int(faces.max()) + 1 if len(faces) else 0
    faces = faces[(faces != faces.roll(1, dims=1)).all(1)]
    sides = torch.cat((faces, faces.roll(-1, dims=1), faces.roll(-2, dims=1)))  # half-edges: (start, end, opposite)
    low, high = sides[:, :2].amin(1), sides[:, :2].amax(1)
    key, order = torch.sort(low * count + high, stable=True)  # half-edges of one edge become adjacent
    low, high, opposite = low[order], high[order], sides[order, 2]
    again = torch.zeros_like(key, dtype=torch.bool)
    again[1:] = key[1:] == key[:-1]
    second = torch.nonzero(again).squeeze(1)
    first = second - 1
    edges = torch.stack((low, high), dim=1)[~again]
    return edges, torch.stack((low[first], high[first], opposite[first], opposite[second]), dim=1)


@fake(edges_and_hinges)
def _(faces: Tensor) -> tuple[Tensor, Tensor]:
    context = torch.library.get_ctx()
    edges, hinges = context.new_dynamic_size(), context.new_dynamic_size()
    return faces.new_empty(edges, 2), faces.new_empty(hinges, 4)
