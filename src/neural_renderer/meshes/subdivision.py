"""Midpoint and Loop subdivision of triangle meshes, and of the attributes of their faces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..base import validate
from ..io.cubes import barycentric_grid, trilinear_texels

SCHEMES = ("midpoint", "loop")

# The corners of the four children of a face (a, b, c), as barycentric weights of a, b and c.
_A, _B, _C, _AB, _BC, _CA = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, 0), (0, 0.5, 0.5), (0.5, 0, 0.5)
_CHILDREN = ((_A, _AB, _CA), (_AB, _B, _BC), (_CA, _BC, _C), (_AB, _BC, _CA))


def split_faces(faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Split faces [F, 3] int64 of ``count`` vertices V into four each, at the midpoints of their edges.

    Returns the edges [E, 2], in ascending order, whose midpoints are the new vertices V, V + 1, …; and the faces [4 F,
    3], the four children of a face one after the other.
    """
    sides = torch.stack((faces, faces.roll(-1, 1)), -1)  # ab, bc, ca
    keys, midpoints = torch.unique(sides.amin(-1) * count + sides.amax(-1), return_inverse=True)
    edges = torch.stack((keys // count, keys % count), 1)
    ab, bc, ca = (midpoints + count).unbind(1)
    a, b, c = faces.unbind(1)
    children = [torch.stack(face, 1) for face in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return edges, torch.stack(children, 1).reshape(-1, 3)


def checked_levels(levels: Any, scheme: Any) -> int:
    """Check the arguments of `Mesh.subdivide`; return the number of levels."""
    if scheme not in SCHEMES:
        raise ValueError(f"scheme: expected one of {', '.join(map(repr, SCHEMES))}, got {scheme!r}")
    return validate.whole("levels", levels, 1)


def subdivided(vertices: Tensor, faces: Tensor, scheme: str) -> tuple[Tensor, Tensor]:
    """Split each face into four, as `Mesh.subdivide`: vertices [V + E, 3], the old ones first, and faces [4 F, 3].

    With the scheme "loop" (Loop, 1987), edges that do not have two faces are creases; a vertex at which the number of
    creases is neither 0 nor 2 is a corner, which does not move.
    """
    edges, split = split_faces(faces.long(), len(vertices))
    ends = vertices[edges]
    middle = ends.mean(1)
    if scheme == "midpoint":
        return torch.cat((vertices, middle)), split.to(faces.dtype)
    sides = split.view(-1, 4, 3)[:, 3].flatten() - len(vertices)  # the edges ab, bc, ca of each face
    opposite = vertices[faces.long().roll(1, 1).flatten()]  # the vertices opposite to these edges
    smooth = torch.bincount(sides, minlength=len(edges)) == 2
    opposite_sum = torch.zeros_like(middle).index_add(0, sides, opposite)
    # Loop's mask of an edge: 3/8 of both ends and 1/8 of both opposite vertices.
    created = torch.where(smooth[:, None], 0.75 * middle + 0.125 * opposite_sum, middle)
    return torch.cat((_smoothed(vertices, edges, ends, ~smooth), created)), split.to(faces.dtype)


def _smoothed(vertices: Tensor, edges: Tensor, ends: Tensor, creases: Tensor) -> Tensor:
    """Move the old vertices by Loop's scheme; ``creases`` [E] bool are the edges that are not smooth."""

    def neighbours(kept: Tensor) -> tuple[Tensor, Tensor]:
        """Count and sum the neighbours of each vertex along the ``kept`` edges."""
        number = torch.bincount(edges[kept].flatten(), minlength=len(vertices))[:, None]
        total = torch.zeros_like(vertices).index_add(0, edges[kept].flatten(), ends[kept].flip(1).flatten(0, 1))
        return number, total

    number, total = neighbours(torch.ones_like(creases))
    several = number.clamp(min=1).to(vertices.dtype)
    # Loop's masks of a vertex of valence n: the neighbours' mean has the weight 5/8 − (3/8 + cos(2π / n) / 4)²; on a
    # crease, both neighbours have 1/8.
    weight = (40 - (3 + 2 * torch.cos(2 * math.pi / several)) ** 2) / 64
    inside = (1 - weight) * vertices + weight * total / several
    number, total = neighbours(creases)
    along = 0.75 * vertices + 0.125 * total
    return torch.where(number == 2, along, torch.where((number == 0) & (several > 1), inside, vertices))


def split_corners(values: Tensor) -> Tensor:
    """Interpolate values of corners [F, 3, C] at the corners of the four children of each face, [4 F, 3, C]."""
    return torch.einsum("nkj,fjc->fnkc", values.new_tensor(_CHILDREN), values).flatten(0, 1)


def split_cubes(cubes: Tensor) -> Tensor:
    """Sample texture cubes [F, T, T, T, 3], as the renderer does, for the four children of each face."""
    size, flat = cubes.shape[1], cubes.flatten(1, 3)
    weights = np.einsum("gk,nkj->ngj", barycentric_grid(size), np.array(_CHILDREN)).reshape(-1, 3)
    index, shares = (torch.from_numpy(part).to(cubes.device) for part in trilinear_texels(weights, size))
    corners = zip(index.unbind(1), shares.to(cubes).unbind(1), strict=True)
    result = sum((share[:, None] * flat[:, texel] for texel, share in corners), torch.zeros_like(flat[:, :1]))
    return result.reshape(-1, size, size, size, 3)
