"""Rings of the edges that faces share, found by vertex indices once for each mesh.

Edge k of face f runs from corner k to the next and has the number 3 f + k. The edges with the same two vertices form a
ring: each edge names the next one, and the last names the first. An edge that no other face shares names itself.
"""

from __future__ import annotations

import collections
import threading
import weakref
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ...base.one_line import OneLine
from ..warp.launch import stream_of
from ..warp.layout import readable
from ..warp.registration import fake, of_constants, operator


@dataclass(frozen=True, repr=False)
class Rings(OneLine):
    """The rings of a mesh."""

    next: Tensor  # next edge in the ring of each edge, [B or 1, F, 3] int32
    alone: int  # number of edges that are alone in their rings; -1 where reading it would wait for the device


@dataclass
class _Kept:
    """The rings of a mesh seen before."""

    faces: Tensor  # a copy, where values can be compared
    source: weakref.ref[Tensor]
    version: int
    rings: Rings


_kept: collections.deque[_Kept] = collections.deque(maxlen=8)
_lock = threading.Lock()


def edge_rings(faces: Tensor) -> Rings:
    """Find the rings of the edges that faces share, by indices [F, 3] or [B or 1, F, 3]; (-1, -1, -1) is padding.

    The rings of the last eight meshes are kept. On the CPU a mesh is recognised by its values. On CUDA comparing values
    would wait for the device, so a mesh is recognised by its tensor, unless the tensor was changed in place.
    """
    return of_constants(_known_rings, faces) or Rings(_edge_rings(faces), -1)


def count_alone(rings: Rings) -> int | None:
    """Count the edges that are alone in their rings; None where reading the number would wait for the device."""
    if rings.alone < 0 and readable(rings.next.device):
        return int(_are_alone(rings.next).sum())
    return None if rings.alone < 0 else rings.alone


@operator
def _edge_rings(faces: Tensor) -> Tensor:
    return _known_rings(faces).next.clone()  # compiled programs may overwrite their inputs


@fake(_edge_rings)
def _(faces: Tensor) -> Tensor:
    return faces.new_empty((1, *faces.shape)[-3:], dtype=torch.int32)


def _known_rings(faces: Tensor) -> Rings:
    """Return the kept rings of a known mesh; otherwise find and keep them."""
    with _lock:
        kept = list(_kept)
    known_by_values = readable(faces.device)
    version = -1 if faces.is_inference() else faces._version
    for one in reversed(kept):
        if one.rings.next.device != faces.device:
            continue
        if known_by_values:
            same = one.faces.shape == faces.shape and one.faces.dtype == faces.dtype and torch.equal(one.faces, faces)
        else:
            same = one.source() is faces and one.version == version >= 0
        if same:
            # On CUDA read once, of a mesh that comes again; not while a graph is captured.
            if one.rings.alone < 0 and stream_of(faces.device) is not None:
                one.rings = replace(one.rings, alone=int(_are_alone(one.rings.next).sum()))
            return one.rings
    following = _find_rings(faces if faces.dim() == 3 else faces[None])
    rings = Rings(following, int(_are_alone(following).sum()) if known_by_values else -1)
    copy = faces.clone() if known_by_values else faces[:0]
    with _lock:
        _kept.append(_Kept(copy, weakref.ref(faces), version, rings))
    return rings


def _are_alone(following: Tensor) -> Tensor:
    own = torch.arange(3 * following.shape[1], dtype=torch.int32, device=following.device)
    return following == own.view(-1, 3)


@torch.inference_mode(False)  # what is kept may be needed with gradients later
@torch.no_grad()
def _find_rings(faces: Tensor) -> Tensor:
    """Sort the edges of faces [B, F, 3] by their vertices, and link equal ones to rings."""
    batch, count = faces.shape[:2]
    start = faces.long()
    end = start.roll(-1, 2)
    low, high = torch.minimum(start, end), torch.maximum(start, end)
    own = torch.arange(3 * count, device=faces.device).expand(batch, -1)
    # Degenerate and padded edges get unique keys. Keys are 31 + 31 bits: reading V could synchronise with the GPU.
    name = torch.where(low == high, -1 - own.view(batch, count, 3), (low << 31) + high)
    name, order = name.flatten(1).sort(dim=1, stable=True)
    last = torch.cat((name[:, 1:] != name[:, :-1], torch.ones_like(name[:, :1], dtype=torch.bool)), 1)
    first = torch.where(last.roll(1, 1), own, 0)
    following = torch.where(last, order.gather(1, first.cummax(1).values), order.roll(-1, 1))
    rings = torch.empty_like(order).scatter_(1, order, following)
    return rings.view(batch, count, 3).int()
