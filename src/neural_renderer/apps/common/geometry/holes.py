"""Holes of a surface: its borders that are simple loops, and faces that close them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .defects import border_edges, connected_borders


def border_loops(faces: Tensor) -> tuple[Tensor, Tensor]:
    """Find the borders of faces [F, 3] that are closed and pass each of their vertices once.

    Returns their edges [N, 2] int64, in the direction of the faces, and the number [N] int64 of the loop of each.
    """
    edges = border_edges(faces.cpu().numpy()) if len(faces) else np.zeros((0, 2), np.int64)
    if not len(edges):
        return faces.new_zeros((0, 2), dtype=torch.int64), faces.new_zeros(0, dtype=torch.int64)
    count, loop = connected_borders(edges)
    simple = np.ones(count, bool)
    for ends in (edges[:, 0], edges[:, 1], edges.T.reshape(-1)):  # an open chain has more vertices than edges
        first = np.unique(ends, return_index=True)[1]
        simple &= np.bincount(loop[first % len(loop)], minlength=count) == np.bincount(loop, minlength=count)
    kept = simple[loop]
    number = np.cumsum(simple) - 1
    found = edges[kept].astype(np.int64), number[loop[kept]].astype(np.int64)
    return torch.from_numpy(found[0]).to(faces.device), torch.from_numpy(found[1]).to(faces.device)


def some_loops(edges: Tensor, loop: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Select the edges of chosen loops [L] bool, numbered anew."""
    kept = chosen[loop]
    return edges[kept], (chosen.cumsum(0) - 1)[loop[kept]]


def lids(points: Tensor, edges: Tensor, loop: Tensor) -> tuple[Tensor, Tensor]:
    """Close all loops of `border_loops`: of three edges by one face, others by a fan around the mean of their vertices.

    Returns the means [M, 3], which follow the vertices [V, 3], and the faces [N, 3].
    """
    start, stop = edges.unbind(1)
    length = torch.bincount(loop)
    is_fan = length > 3
    sums = points.new_zeros(len(length), 3).index_add(0, loop, points[start])
    middle = len(points) + is_fan.cumsum(0) - 1
    fans = torch.stack((stop, start, middle[loop]), 1)[is_fan[loop]]
    number = torch.arange(len(loop), device=loop.device)
    first = torch.full_like(length, len(loop)).scatter_reduce(0, loop, number, "amin")[~is_fan]
    third = torch.zeros_like(length).index_add(0, loop, start)[~is_fan] - start[first] - stop[first]
    triangles = torch.stack((stop[first], start[first], third), 1)
    return (sums / length[:, None])[is_fan], torch.cat((fans, triangles))
