"""Defects of a surface: doubled faces, borders, and edges of more than two faces."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def first_of_equal_faces(faces: Tensor) -> Tensor:
    """Find the first of the faces [F, 3] int64 that have the same three vertices, whatever their order: [F] bool."""
    return equal_faces(faces)[1]


def equal_faces(faces: Tensor) -> tuple[Tensor, Tensor]:
    """Number the sets of three vertices that faces [F, 3] int64 have: the set of each [F], and whether it is the first
    face of its set [F] bool.
    """
    if not len(faces):
        return faces.new_zeros(0), torch.zeros(0, dtype=torch.bool, device=faces.device)
    low, middle, high = faces.sort(1)[0].unbind(1)
    count = int(faces.max()) + 1
    pair = torch.unique(low * count + middle, return_inverse=True)[1]
    group = torch.unique(pair * count + high, return_inverse=True)[1]
    number = torch.arange(len(faces), device=faces.device)
    first = number.new_full((int(group.max()) + 1,), len(faces)).scatter_reduce(0, group, number, "amin")
    return group, first[group] == number


def faced_both_ways(faces: Tensor, group: Tensor) -> Tensor:
    """Find the faces [F, 3] of sets [F] of equal faces in which some face the opposite way: [F] bool."""
    way = ((faces < faces.roll(-1, 1)).sum(1) == 2).long()
    found = torch.zeros(len(faces), 2, dtype=torch.bool, device=faces.device)
    found[group, way] = True
    return found.all(1)[group]


def edges_and_uses(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the edges [E, 2] of faces [F, 3], F ≥ 1, in the direction of their first face, and the faces of each [E]."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    key = sides.min(1) * (int(faces.max()) + 1) + sides.max(1)
    _, first, uses = np.unique(key, return_index=True, return_counts=True)
    return sides[first], uses


def border_edges(faces: np.ndarray) -> np.ndarray:
    """Find the directed edges [N, 2] that one face has and no other face shares in either direction."""
    edges, uses = edges_and_uses(faces)
    return edges[uses == 1]


def count_defects(faces: np.ndarray) -> tuple[int, int]:
    """Count the edges of one face, and those of more than two."""
    uses = edges_and_uses(faces)[1]
    return int((uses == 1).sum()), int((uses > 2).sum())


def connected_borders(border: np.ndarray) -> tuple[int, np.ndarray]:
    """Number the connected borders of border edges [N, 2], N ≥ 1: how many there are, and the one of each edge [N]."""
    from scipy import sparse  # imported here because it takes 0.1 s
    from scipy.sparse import csgraph

    ends, place = np.unique(border, return_inverse=True)
    place = place.reshape(-1, 2)
    graph = sparse.coo_matrix((np.ones(len(border), bool), tuple(place.T)), shape=(len(ends),) * 2)
    number, component = csgraph.connected_components(graph, directed=False)
    return int(number), component[place[:, 0]]
