"""Points of the object that a box in one photograph shows, cut from what it touches by their colours.

Points outside of the box are no object. Those inside may be what is behind it: colours of both parts and the cut of
least cost between neighbours of different colours are estimated in turns (Rother et al., "GrabCut", 2004).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from ..histogram import bins_of, histogram, log_ratio

_NEIGHBOURS, _REACH = 8, 3.0  # of a cell, and their largest distance in cells
_TENSION = 2.0  # cost of a cut between cells of one colour, as a log-likelihood
_ROUNDS = 8
_UNIT = 1000  # capacities are integers


def cut_out(points: np.ndarray, colors: np.ndarray, is_inside: np.ndarray, cell: float) -> np.ndarray:
    """Separate the object from the background: points [P, 3] with colours [P, 3] in [0, 1], some of them [P] in a box.

    Points in a cell of this size stay together.
    """
    _, cells, count = np.unique(
        np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    cells = cells.ravel()

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(cells, column) / count for column in values.T], 1)

    places, shades, inside = mean(points), mean(colors), mean(is_inside[:, None])[:, 0] > 0.5
    first, second, capacity = _edges(places, shades, cell)
    bins, found = bins_of(shades), inside
    for _ in range(_ROUNDS):
        evidence = log_ratio(histogram(bins[found]), histogram(bins[~found]), bins)
        before, found = found, inside & _least_cut(np.where(inside, evidence, -np.inf), first, second, capacity)
        if not found.any() or (before == found).all():
            break
    return found[cells]


def _edges(places: np.ndarray, shades: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the pairs [E], [E] of neighbours among cells [C, 3], and the cost [E] of a cut between them."""
    away, near = cKDTree(places).query(places, min(_NEIGHBOURS + 1, len(places)))
    first, second = np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()
    kept = (away.ravel() < _REACH * cell) & (first != second)
    first, second = first[kept], second[kept]
    change = ((shades[first] - shades[second]) ** 2).sum(1)
    usual = 2 * float(change.mean()) if len(change) else 1.0
    return first, second, _TENSION * np.exp(-change / max(usual, 1e-12))


def _least_cut(evidence: np.ndarray, first: np.ndarray, second: np.ndarray, capacity: np.ndarray) -> np.ndarray:
    """Mark the cells [C] on the object's side of the least cut, for the evidence [C] that they are the object."""
    count = len(evidence)
    cells, source, sink = np.arange(count), np.full(count, count), np.full(count, count + 1)
    most = float(capacity.sum()) + 1
    ours, others = evidence.clip(0, most), (-evidence).clip(0, most)
    rows, columns = np.concatenate((first, second, source, cells)), np.concatenate((second, first, cells, sink))
    values = np.round(np.concatenate((capacity, capacity, ours, others)) * _UNIT).clip(max=np.iinfo(np.int32).max // 2)
    graph = sparse.csr_matrix((values.astype(np.int32), (rows, columns)), (count + 2, count + 2))
    left = graph - csgraph.maximum_flow(graph, count, count + 1).flow
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    reached = csgraph.breadth_first_order(left, count, return_predecessors=False)
    return np.isin(cells, reached)
