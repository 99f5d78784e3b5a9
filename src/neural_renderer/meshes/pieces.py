"""Parts of meshes: some of the faces, and faces without duplicate vertices."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from .. import validate


def chosen_faces(index: Any, faces: Tensor) -> Tensor:
    """Convert a slice, face numbers [N], or a bool for each face [F], to numbers [N] int64 on the faces' device."""
    if isinstance(index, slice):
        index = range(len(faces))[index]
    try:
        index = torch.as_tensor(index, device=faces.device)
    except (TypeError, ValueError, RuntimeError):
        raise TypeError(f"index: expected numbers of faces, or a bool for each, got {type(index).__name__}") from None
    if index.dtype == torch.bool:
        if index.shape != faces.shape[:1]:
            raise ValueError(f"index: expected a bool for each of {len(faces)} faces, got {validate.shape_of(index)}")
        index = torch.nonzero(index)[:, 0]
    index = validate.indices("index", index, ("N",), always=True).long()
    validate.in_range("index", index, len(faces), always=True)
    if not len(index):
        raise ValueError("index: expected at least one face, got none")
    return index


def used_vertices(faces: Tensor) -> tuple[Tensor, Tensor]:
    """Number the vertices that faces use: return their old numbers [N] int64, ascending, and the faces in new ones."""
    rows, numbers = torch.unique(faces.long(), return_inverse=True)
    return rows, numbers.to(faces.dtype)


def merged_vertices(vertices: Tensor, faces: Tensor, tolerance: float) -> tuple[Tensor, Tensor]:
    """Find vertices in the same place: return the number of the first in each place, and the faces in new numbers.

    The ``tolerance`` is as in `Mesh.merge_vertices`.
    """
    tolerance = validate.not_negative("tolerance", tolerance)
    places = vertices.detach().double()
    places = torch.round(places / tolerance) if tolerance else places
    found, place = torch.unique(places + 0.0, dim=0, return_inverse=True)  # −0 + 0 is 0
    count = len(vertices)
    numbers = torch.arange(count, device=place.device)
    firsts = numbers.new_full((len(found),), count).scatter_reduce(0, place, numbers, "amin")
    rows, order = torch.sort(firsts)  # order of the mesh, not of the coordinates
    new = torch.empty_like(order).scatter(0, order, torch.arange(len(order), device=order.device))
    return rows, new[place[faces.long()]].to(faces.dtype)
