"""Splitting edges at their midpoints."""

from __future__ import annotations

import torch
from torch import Tensor

from .edges import Edges, lengths
from .surface import Surface

LONG = 4 / 3  # length, relative to the target, above which a split brings edges nearer to the target


def split_long(surface: Surface) -> Surface:
    """Split every edge that is too long, once."""
    edges = Edges.of(surface.faces, len(surface.values))
    return split(surface, edges, lengths(surface.vertices, edges.ends) > LONG * surface.target_of(edges.ends))


def split(surface: Surface, edges: Edges, chosen: Tensor) -> Surface:
    """Split edges at their midpoints.

    Args:
        surface: The mesh.
        edges: Its edges.
        chosen: [E] bool, the edges to split. Any set will do.

    Returns:
        The mesh; a face with one, two or three split edges becomes two, three or four. The old vertices come first.
    """
    if not bool(chosen.any()):
        return surface
    values = torch.cat((surface.values, surface.values[edges.ends[chosen]].mean(1)))
    middle = torch.where(chosen, len(surface.values) + chosen.cumsum(0) - 1, -1)[edges.sides]  # −1: not split
    number = (middle >= 0).sum(1)
    faces = [surface.faces[number == 0]]
    # Faces are turned so that one split side is ab, and two split sides are ab and bc.
    is_split = middle >= 0
    begin = torch.where(number == 2, ((~is_split).int().argmax(1) + 1) % 3, is_split.int().argmax(1))
    turn = (torch.arange(3, device=begin.device) + begin[:, None]) % 3
    (a, b, c), (ab, bc, ca) = surface.faces.gather(1, turn).unbind(1), middle.gather(1, turn).unbind(1)
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
