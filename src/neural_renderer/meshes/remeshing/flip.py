"""Flipping edges towards six neighbours of each vertex."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from .edges import Edges, area_vectors
from .surface import Surface

_REGULAR, _AT_BORDER = 6, 4  # best number of neighbours, inside a surface and at its border
_LEAST_COSINE = 0.9  # least cosine of two normals after a flip, unless they met at a sharper angle before
_LEAST_SINE = 0.1  # least sine of a face's angles after a flip


def flip_edges(surface: Surface, rounds: int = 4) -> Surface:
    """Flip edges where that brings the four vertices around nearer to six neighbours.

    In each round, edges are flipped that gain more than all other candidates with a vertex in common. An edge stays if
    the surface would become sharper there, or if the other two vertices are connected already.

    Args:
        surface: The mesh.
        rounds: Largest number of rounds.

    Returns:
        The mesh; its vertices are the same.
    """
    faces = surface.faces
    for _ in range(rounds):
        edges = Edges.of(faces, len(surface.values))
        chosen, quads = _choose(surface.vertices, faces, edges)
        if not len(chosen):
            break
        u, v, a, b = quads.unbind(1)
        faces = faces.index_copy(0, edges.faces[chosen, 0], torch.stack((a, u, b), 1))
        faces.index_copy_(0, edges.faces[chosen, 1], torch.stack((b, v, a), 1))
    return Surface(surface.values, faces)


def _choose(vertices: Tensor, faces: Tensor, edges: Edges) -> tuple[Tensor, Tensor]:
    """Choose edges to flip: their numbers [N], and u, v, a, b [N, 4] of the faces (u, v, a) and (v, u, b)."""
    valence = edges.valence()
    surplus = valence - torch.where(edges.fixed, _AT_BORDER, _REGULAR)
    around = torch.cat((edges.ends, edges.opposite), 1)
    change = torch.tensor([-1, -1, 1, 1], device=faces.device)
    # Σ (s + d)² − s² = Σ 2 s d + 1
    gain = -(2 * (surplus[around] * change).sum(1) + 4)
    rows = torch.nonzero(edges.regular & (gain > 0) & (valence[edges.ends].amin(1) > 3))[:, 0]
    (a, b), count = edges.opposite[rows].unbind(1), len(valence)
    joined = edges.contain(torch.minimum(a, b) * count + torch.maximum(a, b))
    rows = rows[~joined & (a != b)]
    # The first face may have the edge in either direction.
    first, u = faces[edges.faces[rows, 0]], edges.ends[rows, 0]
    a, b = edges.opposite[rows].unbind(1)
    follows = first.gather(1, (((first == a[:, None]).int().argmax(1) + 1) % 3)[:, None])[:, 0]
    u, v = follows, edges.ends[rows].sum(1) - follows
    quads = torch.stack((u, v, a, b), 1)
    allowed = _is_allowed(vertices, quads)
    rows, quads = rows[allowed], quads[allowed]
    order = torch.argsort(gain[rows], descending=True, stable=True)
    rows, quads = rows[order], quads[order]
    rank = torch.arange(len(rows), device=rows.device)
    least = torch.full_like(valence, len(rows)).scatter_reduce(0, quads.flatten(), rank.repeat_interleave(4), "amin")
    wins = rank == least[quads].amin(1)
    return rows[wins], quads[wins]


def _is_allowed(vertices: Tensor, quads: Tensor) -> Tensor:
    """Tell which quads [N, 4] may get the other diagonal, [N] bool."""
    before = area_vectors(vertices[quads[:, [0, 1, 2]]]), area_vectors(vertices[quads[:, [1, 0, 3]]])
    after = area_vectors(vertices[quads[:, [2, 0, 3]]]), area_vectors(vertices[quads[:, [3, 1, 2]]])
    cosine = (normalize(after[0], dim=1) * normalize(after[1], dim=1)).sum(1)
    old = (normalize(before[0], dim=1) * normalize(before[1], dim=1)).sum(1)
    middle = before[0] + before[1]
    ahead = torch.minimum((after[0] * middle).sum(1), (after[1] * middle).sum(1)) > 0
    u, v, a, b = vertices[quads].unbind(1)
    widest = torch.stack([(p - q).square().sum(1) for p, q in ((a, b), (a, u), (a, v), (b, u), (b, v))]).amax(0)
    area = torch.minimum(after[0].norm(dim=1), after[1].norm(dim=1))
    return (cosine >= torch.clamp(old, max=_LEAST_COSINE)) & ahead & (area > _LEAST_SINE * widest)
