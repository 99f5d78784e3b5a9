"""Midpoint subdivision of triangle meshes."""

from __future__ import annotations

import torch
from torch import Tensor


def split_faces(faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Split each face into four at the midpoints of its edges.

    Args:
        faces: [F, 3] int64.
        count: Number of vertices V.

    Returns:
        The edges [E, 2], in ascending order, whose midpoints are the new vertices V, V + 1, …; and the faces [4 F, 3],
        the four of each face one after the other.
    """
    sides = torch.stack((faces, faces.roll(-1, 1)), -1)  # ab, bc, ca
    keys, midpoints = torch.unique(sides.amin(-1) * count + sides.amax(-1), return_inverse=True)
    edges = torch.stack((keys // count, keys % count), 1)
    ab, bc, ca = (midpoints + count).unbind(1)
    a, b, c = faces.unbind(1)
    children = [torch.stack(face, 1) for face in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return edges, torch.stack(children, 1).reshape(-1, 3)
