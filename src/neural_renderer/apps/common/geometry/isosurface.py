"""Isosurface extraction by naive surface nets."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

Field = Callable[[np.ndarray], np.ndarray]  # from points [..., 3] to values [...], negative inside
CORNERS = tuple(itertools.product((0, 1), repeat=3))
"""Offsets of the corners of a cell."""


def isosurface(field: Field, steps: int, half: float = 1.15) -> tuple[Tensor, Tensor]:
    """Extract the surface field = 0 in [−half, half]³, inside of it, by `surface_net` on steps³ cells.

    Returns vertices [V, 3] float32 and outward faces [F, 3] int64.
    """
    grid = np.moveaxis(np.indices((steps + 1,) * 3), 0, -1).astype(np.float64)
    values = np.ascontiguousarray(field(grid * (2 * half / steps) - half))
    inside = [(values < 0)[x : x + steps, y : y + steps, z : z + steps] for x, y, z in CORNERS]
    cells = np.argwhere(np.logical_or.reduce(inside) & ~np.logical_and.reduce(inside))
    at_corners = [values[tuple((cells + corner).T)] for corner in CORNERS]
    points, quads = surface_net(torch.from_numpy(cells), torch.from_numpy(np.stack(at_corners, 1)))
    return (points * (2 * half / steps) - half).float(), quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def surface_net(cells: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Find the surface where values change their sign by naive surface nets (Gibson, "Constrained elastic surface
    nets", 1998).

    A cell with a sign change gets one vertex, at the mean of the crossings of its edges. A crossed edge gets a quad
    that connects the vertices of its four cells, if these are given.

    Args:
        cells: [N, 3] int64, different cells of a grid, not negative.
        values: [N, 8] floating, at their `CORNERS`, negative inside.

    Returns:
        Points [P, 3] float64 in units of cells, in the order of the grid, and outward quads [Q, 4] int64.
    """
    total, count = torch.zeros(len(cells), 3).to(values.device, torch.float64), torch.zeros_like(values[:, :1]).double()
    side = int(cells.max()) + 2 if len(cells) else 2
    strides = (side**2, side, 1)
    key = (cells * cells.new_tensor(strides)).sum(1)
    own, order = torch.sort(key)
    quads = []
    for axis in range(3):
        p, q = (axis + 1) % 3, (axis + 2) % 3
        for i, j in itertools.product((0, 1), repeat=2):
            corner = i * (4 >> p) + j * (4 >> q)
            low, high = values[:, corner], values[:, corner + (4 >> axis)]
            crossed = ((low < 0) != (high < 0))[:, None]
            where = (cells + cells.new_tensor(CORNERS[corner])).double()
            where[:, axis] += low / (low - high)
            total += torch.where(crossed, where, 0.0)
            count += crossed
        low, high = values[order, 0], values[order, 4 >> axis]
        crossed = torch.nonzero((low < 0) != (high < 0))[:, 0]
        edge, outward = own[crossed], low[crossed] < 0
        around = torch.stack((edge - strides[p] - strides[q], edge - strides[q], edge, edge - strides[p]), 1)
        place = torch.searchsorted(own, around).clamp(max=max(len(own) - 1, 0))
        whole = (own[place] == around).all(1)
        quad = torch.where(outward[:, None], place, place.flip(1))
        quads.append(quad[whole])
    used, numbers = torch.unique(torch.cat(quads), return_inverse=True)
    return (total / count)[order[used]], numbers
