"""Neighbours of faces: the adjacent face across each edge, where the surface continues on the screen.

The adjacent face is the drawn face of lowest index that has the same two corners, equal to the last bit, and lies on
the other side of the edge on the screen. An edge at a border or at a fold of the surface has no adjacent face.

No topology is needed: a hash table for each image finds the faces with the same corners. If the mesh's `edge_rings` are
given, the table holds only edges that are alone in their ring, such as those between duplicated vertices.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from .rings import Rings, count_alone

_KERNELS = Kernels(__name__, "neighbors.h")
_Scene, _Rings, Neighbors = (_KERNELS.struct(name) for name in ("Scene", "Rings", "Neighbors"))
_search_rings_of_face = _KERNELS.kernel("search_rings_of_face", Neighbors)
_insert_edges = _KERNELS.kernel("insert_edges", Neighbors)
_search_table = _KERNELS.kernel("search_table", Neighbors)

_LEAST = 512  # faces that are worth another CPU thread


def rings_of(rings: Rings | None) -> Call:
    """Make the `Rings` of kernels, from the result of `edge_rings`."""
    return _Rings() if rings is None else _Rings(next=rings.next, owners=len(rings.next))


def neighbors(
    faces: Tensor,
    two_sided: bool,
    perspective: bool,
    rings: Rings | None = None,
    folds: bool = False,
) -> Tensor:
    """Find the adjacent face across each edge, or with ``folds`` the one that the surface folds back to.

    That one has the same two corners, on the same side of the edge. Faces are as in `coverage`, ``rings`` as from
    `edge_rings` for their vertex indices.

    Returns:
        [B, F, 3] int32: the face across edge k, from corner k to the next; -1 for none and for faces that are not
        drawn.
    """
    batch, count = faces.shape[:2]
    result = empty((batch, count, 3), faces.device, torch.int32)
    fields: dict[str, Any] = {
        "scene": _Scene(faces=faces, images=batch, count=count, perspective=perspective),
        "two_sided": two_sided,
        "way": 1 if folds else -1,
        "rings": rings_of(rings),
        "adjacent": result,
    }
    most = 3 * count
    if rings is not None:
        launch(_search_rings_of_face, batch * count, [Neighbors(**fields)], faces.device, _LEAST)
        alone = count_alone(rings)
        most = most if alone is None else alone
    if most == 0:
        return result
    # One CPU task fills an image's table. Several tasks fill it in any order, which decides which faces are
    # ignored at an edge with more faces than are examined.
    lanes = max(count, 1) if in_any_order(faces.device) else 1
    size = 1 << (2 * most - 1).bit_length()
    call = Neighbors(table=zeros((batch, size), faces.device, torch.int32), size=size, lanes=lanes, **fields)
    launch(_insert_edges, batch * lanes, [call], faces.device)
    launch(_search_table, batch * count, [call], faces.device, _LEAST)
    return result
