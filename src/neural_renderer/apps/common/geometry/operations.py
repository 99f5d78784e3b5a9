"""The operations of remeshing, vectorised over edges: splits, collapses and flips of edges, and smoothing."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from .edges import Edges, area_vectors, lengths
from .surface import Surface

_LONG, _SHORT = 4 / 3, 4 / 5  # length relative to the target above which edges split, and below which they collapse
_COLLAPSED_COSINE = 0.3  # least cosine between the normals of a face before and after a collapse
_LEAST_QUALITY = 0.05  # least quality of a face after a collapse, unless it was worse: 1 for an equilateral triangle
_REGULAR, _AT_BOUNDARY = 6, 4  # ideal valence inside a surface and at its boundary
_FLIPPED_COSINE = 0.9  # least cosine between the normals of two faces after a flip, unless it was less before
_LEAST_SINE = 0.1  # least sine of the angles of a face after a flip
_MOVED_COSINE = 0.5  # least cosine between the normals of a face before and after its vertices move
_LEAST_AREA = 0.1  # least area of a face after its vertices move, relative to before


def split_long(surface: Surface) -> Surface:
    """Split all edges that are too long, each once."""
    edges = surface.edges
    return split(surface, edges, lengths(surface.vertices, edges.ends) > _LONG * surface.target_of(edges.ends))


def split(surface: Surface, edges: Edges, chosen: Tensor) -> Surface:
    """Split the chosen edges [E] bool, any set of them, at their midpoints.

    A face with one, two or three split edges becomes two, three or four. The old vertices come first.
    """
    if not bool(chosen.any()):
        return surface
    values = torch.cat((surface.values, surface.values[edges.ends[chosen]].mean(1)))
    middle = torch.where(chosen, len(surface.values) + chosen.cumsum(0) - 1, -1)[edges.sides]  # −1: not split
    number = (middle >= 0).sum(1)
    faces = [surface.faces[number == 0]]
    # Rotate the corners of faces so that a single split side is ab, and two are ab and bc.
    is_split = middle >= 0
    begin = torch.where(number == 2, ((~is_split).int().argmax(1) + 1) % 3, is_split.int().argmax(1))
    order = (torch.arange(3, device=begin.device) + begin[:, None]) % 3
    (a, b, c), (ab, bc, ca) = surface.faces.gather(1, order).unbind(1), middle.gather(1, order).unbind(1)
    shorter = (values[ab, :3] - values[c, :3]).norm(dim=1) < (values[a, :3] - values[bc, :3]).norm(dim=1)
    for rows, corners in (
        (number == 1, ((a, ab, c), (ab, b, c))),
        (number == 2, ((ab, b, bc),)),
        ((number == 2) & shorter, ((a, ab, c), (ab, bc, c))),
        ((number == 2) & ~shorter, ((a, ab, bc), (a, bc, c))),
        (number == 3, ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))),
    ):
        faces += [torch.stack(face, 1)[rows] for face in corners]
    return Surface(values, torch.cat(faces))


def collapse_short(surface: Surface, rounds: int = 4) -> Surface:
    """Collapse edges that are too short to their midpoints, in at most ``rounds`` rounds; remove unused vertices.

    A round collapses those that are shorter than all candidates within one edge of their ends. An edge is kept if its
    collapse would change the topology, flip a face, make a sliver, or make an edge that is too long.
    """
    refused = surface.faces.new_empty(0)
    for _ in range(rounds):
        edges = surface.edges
        size = lengths(surface.vertices, edges.ends)
        candidates = edges.regular & (size < _SHORT * surface.target_of(edges.ends))
        candidates &= ~edges.fixed[edges.ends].all(1)
        candidates &= (edges.valence()[edges.ends].sum(1) >= 7) & ~torch.isin(edges.keys, refused)
        chosen = _independent(edges, candidates, size)
        if not len(chosen):
            break
        wrong = _is_wrong(surface, edges, chosen)
        refused = torch.cat((refused, edges.keys[chosen[wrong]]))
        surface = _collapse(surface, edges, chosen[~wrong])
    return surface.compact()


def _independent(edges: Edges, candidates: Tensor, size: Tensor) -> Tensor:
    """Select an independent set of the candidates [E] bool, the shortest first: edges [N] without adjacent ends."""
    rows = torch.nonzero(candidates)[:, 0]
    rows = rows[torch.argsort(size[rows], stable=True)]
    rank = torch.arange(len(rows), device=rows.device)
    none = torch.full_like(edges.fixed, len(rows), dtype=torch.int64)
    ends = edges.ends[rows]
    least = none.scatter_reduce(0, ends.flatten(), rank.repeat_interleave(2), "amin")
    a, b = edges.ends.unbind(1)
    around = least.scatter_reduce(0, a, least[b], "amin").scatter_reduce(0, b, least[a], "amin")
    return rows[rank <= around[ends].amin(1)]


def _merged(surface: Surface, edges: Edges, chosen: Tensor) -> Tensor:
    """Compute the values [N, 4 + C] of the vertices to which edges collapse: the midpoint, or the fixed end."""
    ends = surface.values[edges.ends[chosen]]
    fixed = edges.fixed[edges.ends[chosen]].to(ends.dtype)[..., None]
    weight = torch.where(fixed.sum(1, keepdim=True) > 0, fixed, 0.5)
    return (weight * ends).sum(1)


def _is_wrong(surface: Surface, edges: Edges, chosen: Tensor) -> Tensor:
    """Return which of the chosen edges [N] must not collapse. Each face has at most one of them."""
    count, device = len(chosen), chosen.device
    ends = edges.ends[chosen]
    owner = torch.full_like(edges.fixed, -1, dtype=torch.int64)
    owner[ends.flatten()] = torch.arange(count, device=device).repeat_interleave(2)
    after = surface.vertices.index_copy(
        0, ends.flatten(), _merged(surface, edges, chosen)[:, :3].repeat_interleave(2, 0)
    )
    wrong = torch.zeros(count + 1, dtype=torch.bool, device=device)  # the last entry is for −1

    # The link condition (Dey et al., 1999): only the two opposite vertices are adjacent to both ends.
    owners = owner[edges.ends]
    around = torch.nonzero(owners[:, 0] != owners[:, 1])[:, 0]
    pairs = torch.cat((edges.ends[around], edges.ends[around].flip(1)))
    pairs = pairs[owner[pairs[:, 0]] >= 0]
    key = torch.sort(owner[pairs[:, 0]] * len(owner) + pairs[:, 1]).values
    shared = key[1:][key[1:] == key[:-1]] // len(owner)
    wrong[:count] = torch.bincount(shared, minlength=count) != 2

    candidate = owners[around].amax(1)
    ends = edges.ends[around]
    length = lengths(after, ends)
    wrong[candidate[(length > _LONG * surface.target_of(ends)) & (length > lengths(surface.vertices, ends))]] = True

    candidate = owner[surface.faces]
    rows = torch.nonzero((candidate >= 0).sum(1) == 1)[:, 0]
    candidate, faces = candidate[rows].amax(1), surface.faces[rows]
    old, new = surface.vertices[faces], after[faces]
    before, now = area_vectors(old), area_vectors(new)
    size, quality = now.norm(dim=1), _quality(new)
    flipped = (before * now).sum(1) < _COLLAPSED_COSINE * before.norm(dim=1) * size
    sliver = (quality < _LEAST_QUALITY) & (quality <= _quality(old))
    wrong[candidate[flipped | sliver | ~(size > 0)]] = True
    return wrong[:count]


def _quality(corners: Tensor) -> Tensor:
    """Compute the quality 4 √3 · area / Σ edge² of faces [F, 3, 3], [F]: 1 for an equilateral triangle."""
    squares = (corners - corners.roll(-1, 1)).square().sum((1, 2))
    return 2 * 3**0.5 * area_vectors(corners).norm(dim=1) / squares.clamp(min=torch.finfo(squares.dtype).tiny)


def _collapse(surface: Surface, edges: Edges, chosen: Tensor) -> Surface:
    kept, dropped = edges.ends[chosen].unbind(1)
    values = surface.values.index_copy(0, kept, _merged(surface, edges, chosen))
    names = torch.arange(len(values), device=kept.device).index_copy(0, dropped, kept)
    faces = names[surface.faces]
    return Surface(values, faces[(faces != faces.roll(1, 1)).all(1)])


def flip_edges(surface: Surface, rounds: int = 4) -> Surface:
    """Flip edges where that brings the valences of the four vertices nearer to six, in at most ``rounds`` rounds.

    A round flips those that gain more than all candidates with a vertex in common. An edge is kept if the flip would
    crease the surface, or if the opposite vertices are already connected.
    """
    for _ in range(rounds):
        edges = surface.edges
        chosen, quads = _choose(surface.vertices, surface.faces, edges)
        if not len(chosen):
            break
        u, v, a, b = quads.unbind(1)
        faces = surface.faces.index_copy(0, edges.faces[chosen, 0], torch.stack((a, u, b), 1))
        faces.index_copy_(0, edges.faces[chosen, 1], torch.stack((b, v, a), 1))
        surface = Surface(surface.values, faces)
    return surface


def _choose(vertices: Tensor, faces: Tensor, edges: Edges) -> tuple[Tensor, Tensor]:
    """Select edges to flip: their indices [N], and u, v, a, b [N, 4] of the faces (u, v, a) and (v, u, b)."""
    valence = edges.valence()
    surplus = valence - torch.where(edges.fixed, _AT_BOUNDARY, _REGULAR)
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
    """Return which quads [N, 4] may be flipped, [N] bool."""
    before = area_vectors(vertices[quads[:, [0, 1, 2]]]), area_vectors(vertices[quads[:, [1, 0, 3]]])
    after = area_vectors(vertices[quads[:, [2, 0, 3]]]), area_vectors(vertices[quads[:, [3, 1, 2]]])
    cosine = (normalize(after[0], dim=1) * normalize(after[1], dim=1)).sum(1)
    old = (normalize(before[0], dim=1) * normalize(before[1], dim=1)).sum(1)
    middle = before[0] + before[1]
    ahead = torch.minimum((after[0] * middle).sum(1), (after[1] * middle).sum(1)) > 0
    u, v, a, b = vertices[quads].unbind(1)
    widest = torch.stack([(p - q).square().sum(1) for p, q in ((a, b), (a, u), (a, v), (b, u), (b, v))]).amax(0)
    area = torch.minimum(after[0].norm(dim=1), after[1].norm(dim=1))
    return (cosine >= torch.clamp(old, max=_FLIPPED_COSINE)) & ahead & (area > _LEAST_SINE * widest)


def relax(surface: Surface, strength: float = 0.5) -> Surface:
    """Move vertices along the surface without flipping faces; boundary vertices are fixed.

    A ``strength`` of 1 moves a vertex to the mean of its neighbours.
    """
    vertices, faces, edges = surface.vertices, surface.faces, surface.edges
    a, b = edges.ends.unbind(1)
    total = torch.zeros_like(vertices).index_add(0, a, vertices[b]).index_add(0, b, vertices[a])
    offset = total / edges.valence().clamp(min=1)[:, None] - vertices
    facing = area_vectors(vertices[faces])
    normal = torch.zeros_like(vertices).index_add(0, faces.flatten(), facing.repeat_interleave(3, 0))
    normal = normalize(normal, dim=1)
    offset = strength * (offset - (offset * normal).sum(1, keepdim=True) * normal)
    return surface.moved(move_safely(vertices, vertices + offset * ~edges.fixed[:, None], faces))


def move_safely(vertices: Tensor, goal: Tensor, faces: Tensor) -> Tensor:
    """Move vertices [V, 3] to ``goal``, except those of faces [F, 3] that would flip or degenerate."""
    before = area_vectors(vertices[faces])
    size = before.norm(dim=1)
    while True:
        now = area_vectors(goal[faces])
        wrong = (before * now).sum(1) < size * torch.maximum(_MOVED_COSINE * now.norm(dim=1), _LEAST_AREA * size)
        wrong &= (goal[faces] != vertices[faces]).flatten(1).any(1)
        if not bool(wrong.any()):
            return goal
        rows = faces[wrong].flatten()
        goal = goal.index_copy(0, rows, vertices[rows])
