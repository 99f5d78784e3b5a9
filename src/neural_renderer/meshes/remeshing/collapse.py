"""Collapsing short edges, many at once, without changing the topology."""

from __future__ import annotations

import torch
from torch import Tensor

from .edges import Edges, area_vectors, least_of_neighbors, lengths
from .split import LONG
from .surface import Surface

_SHORT = 4 / 5  # length, relative to the target, below which edges collapse
_LEAST_COSINE = 0.3  # least cosine between a face's normals before and after
_LEAST_QUALITY = 0.05  # least quality of a face afterwards, unless it was worse: 1 for an equilateral triangle


def collapse_short(surface: Surface, rounds: int = 4) -> Surface:
    """Collapse edges that are too short to their midpoints.

    In each round, edges are collapsed that are shorter than all candidates within one edge of their ends. The others
    wait for the next round. An edge stays if its collapse would change the topology, turn a face over, make a sliver,
    or make an edge that is too long.

    Args:
        surface: The mesh.
        rounds: Largest number of rounds.

    Returns:
        The mesh, without unused vertices.
    """
    refused = surface.faces.new_empty(0)
    for _ in range(rounds):
        edges = Edges.of(surface.faces, len(surface.values))
        size = lengths(surface.vertices, edges.ends)
        candidates = edges.regular & (size < _SHORT * surface.target_of(edges.ends))
        candidates &= ~edges.fixed[edges.ends].all(1)
        candidates &= (edges.valence()[edges.ends].sum(1) >= 7) & ~torch.isin(edges.keys, refused)
        chosen = _apart(edges, candidates, size)
        if not len(chosen):
            break
        wrong = _is_wrong(surface, edges, chosen)
        refused = torch.cat((refused, edges.keys[chosen[wrong]]))
        surface = _collapse(surface, edges, chosen[~wrong])
    return surface.compact()


def _apart(edges: Edges, candidates: Tensor, size: Tensor) -> Tensor:
    """Choose candidates [E] bool, the shortest first, whose ends are not adjacent to each other: numbers [N]."""
    rows = torch.nonzero(candidates)[:, 0]
    rows = rows[torch.argsort(size[rows], stable=True)]
    rank = torch.arange(len(rows), device=rows.device)
    none = torch.full_like(edges.fixed, len(rows), dtype=torch.int64)
    ends = edges.ends[rows]
    least = none.scatter_reduce(0, ends.flatten(), rank.repeat_interleave(2), "amin")
    return rows[rank <= least_of_neighbors(least, edges.ends)[ends].amin(1)]


def _merged(surface: Surface, edges: Edges, chosen: Tensor) -> Tensor:
    """Compute the values [N, 4 + C] where edges collapse to: the midpoint, or the end that is fixed."""
    ends = surface.values[edges.ends[chosen]]
    fixed = edges.fixed[edges.ends[chosen]].to(ends.dtype)[..., None]
    weight = torch.where(fixed.sum(1, keepdim=True) > 0, fixed, 0.5)
    return (weight * ends).sum(1)


def _is_wrong(surface: Surface, edges: Edges, chosen: Tensor) -> Tensor:
    """Tell which of the chosen edges [N] must not collapse. A face touches one chosen edge at most."""
    count, device = len(chosen), chosen.device
    ends = edges.ends[chosen]
    owner = torch.full_like(edges.fixed, -1, dtype=torch.int64)
    owner[ends.flatten()] = torch.arange(count, device=device).repeat_interleave(2)
    after = surface.vertices.index_copy(
        0, ends.flatten(), _merged(surface, edges, chosen)[:, :3].repeat_interleave(2, 0)
    )
    wrong = torch.zeros(count + 1, dtype=torch.bool, device=device)  # last entry: no edge, −1

    # The link condition: only the two vertices opposite of the edge are adjacent to both ends.
    owners = owner[edges.ends]
    around = torch.nonzero(owners[:, 0] != owners[:, 1])[:, 0]
    pairs = torch.cat((edges.ends[around], edges.ends[around].flip(1)))
    pairs = pairs[owner[pairs[:, 0]] >= 0]
    key = torch.sort(owner[pairs[:, 0]] * len(owner) + pairs[:, 1]).values
    shared = key[1:][key[1:] == key[:-1]] // len(owner)
    wrong[:count] = torch.bincount(shared, minlength=count) != 2

    place = owners[around].amax(1)
    ends = edges.ends[around]
    length = lengths(after, ends)
    wrong[place[(length > LONG * surface.target_of(ends)) & (length > lengths(surface.vertices, ends))]] = True

    place = owner[surface.faces]
    rows = torch.nonzero((place >= 0).sum(1) == 1)[:, 0]
    place, faces = place[rows].amax(1), surface.faces[rows]
    old, new = surface.vertices[faces], after[faces]
    before, now = area_vectors(old), area_vectors(new)
    size, quality = now.norm(dim=1), _quality(new)
    turned = (before * now).sum(1) < _LEAST_COSINE * before.norm(dim=1) * size
    sliver = (quality < _LEAST_QUALITY) & (quality <= _quality(old))
    wrong[place[turned | sliver | ~(size > 0)]] = True
    return wrong[:count]


def _quality(corners: Tensor) -> Tensor:
    """Compute the area of faces [F, 3, 3] relative to that of an equilateral triangle with edges as long, [F]."""
    squares = (corners - corners.roll(-1, 1)).square().sum((1, 2))
    return 2 * 3**0.5 * area_vectors(corners).norm(dim=1) / squares.clamp(min=torch.finfo(squares.dtype).tiny)


def _collapse(surface: Surface, edges: Edges, chosen: Tensor) -> Surface:
    """Collapse edges [N] that are apart."""
    kept, dropped = edges.ends[chosen].unbind(1)
    values = surface.values.index_copy(0, kept, _merged(surface, edges, chosen))
    names = torch.arange(len(values), device=kept.device).index_copy(0, dropped, kept)
    faces = names[surface.faces]
    return Surface(values, faces[(faces != faces.roll(1, 1)).all(1)])
