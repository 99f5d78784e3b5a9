"""Neighbours of faces: the adjacent face across each edge, where the surface continues on the screen.

The adjacent face is the drawn face of lowest index that has the same two corners, equal to the last bit, and lies on
the other side of the edge on the screen. An edge at a border or at a fold of the surface has no adjacent face.

A hash table for each image finds the faces with the same corners, without the mesh's topology. With the mesh's
`HalfEdges`, the table holds boundary edges only, such as those between duplicated vertices.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from .half_edges import HalfEdges, count_boundary

_KERNELS = Kernels(__name__, "neighbors.h")
_Scene, _HalfEdges, Neighbors = (_KERNELS.struct(name) for name in ("Scene", "HalfEdges", "Neighbors"))
_search_half_edges_of_face = _KERNELS.kernel("search_half_edges_of_face", Neighbors)
_turn_of_face = _KERNELS.kernel("turn_of_face", Neighbors)
_insert_edges = _KERNELS.kernel("insert_edges", Neighbors)
_search_table = _KERNELS.kernel("search_table", Neighbors)

_LEAST = 512  # faces that justify another CPU thread
_MANY = 4096  # with at least as many faces, their orientation on the screen is computed once


def half_edges_of(half_edges: HalfEdges | None) -> Call:
    """Make the `HalfEdges` of kernels; null pointers without half-edges."""
    if half_edges is None:
        return _HalfEdges()
    return _HalfEdges(siblings=half_edges.siblings, owners=len(half_edges.siblings))


def neighbors(
    faces: Tensor,
    two_sided: bool,
    perspective: bool,
    half_edges: HalfEdges | None = None,
    folds: bool = False,
) -> Tensor:
    """Find the adjacent face across each edge, or with ``folds`` the face to which the surface folds back.

    The latter has the same two corners and lies on the same side of the edge. Faces are as in `coverage`,
    ``half_edges`` those of their vertex indices.

    Returns:
        [B, F, 3] int32: the face across edge k, from corner k to the next; -1 for none, and for faces not drawn.
    """
    batch, count = faces.shape[:2]
    result = empty((batch, count, 3), faces.device, torch.int32)
    fields: dict[str, Any] = {
        "scene": _Scene(faces=faces, images=batch, count=count, perspective=perspective),
        "two_sided": two_sided,
        "side": 1 if folds else -1,
        "half_edges": half_edges_of(half_edges),
        "adjacent": result,
    }
    most = 3 * count
    if batch * count >= _MANY:
        fields["turns"] = torch.empty((batch, count), dtype=torch.uint8, device=faces.device)
        launch(_turn_of_face, batch * count, [Neighbors(**fields)], faces.device, _LEAST)
    if half_edges is not None:
        launch(_search_half_edges_of_face, batch * count, [Neighbors(**fields)], faces.device, _LEAST)
        boundary = count_boundary(half_edges)
        most = most if boundary is None else boundary
    if most == 0:
        return result
    # One CPU task fills the table of an image. The order of several tasks would decide which faces are ignored at an
    # edge with more faces than MOST_EQUALS.
    lanes = max(count, 1) if in_any_order(faces.device) else 1
    size = 1 << (2 * most - 1).bit_length()
    call = Neighbors(table=zeros((batch, size), faces.device, torch.int32), size=size, lanes=lanes, **fields)
    launch(_insert_edges, batch * lanes, [call], faces.device)
    launch(_search_table, batch * count, [call], faces.device, _LEAST)
    return result
