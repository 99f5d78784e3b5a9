"""Rings of the edges that faces share, found by vertex indices once for each mesh.

Edge k of face f runs from corner k to the next and has the number 3 f + k. The edges with the same two vertices form a
ring: each names the next one, and the last names the first. An edge that no other face shares names itself.
"""

from __future__ import annotations

import collections
import threading
import weakref
from typing import NamedTuple

import torch
from torch import Tensor

from ..warp.launch import stream_of
from ..warp.layout import readable
from ..warp.registration import fake, is_plain, operator


class _Kept(NamedTuple):
    """The rings of a mesh seen before."""

    faces: Tensor  # a copy, where values can be compared
    source: weakref.ref[Tensor]
    version: int
    rings: Tensor


_kept: collections.deque[_Kept] = collections.deque(maxlen=8)
_lock = threading.Lock()


def edge_rings(faces: Tensor) -> Tensor:
    """Find the rings of the edges that faces share.

    The rings of the last eight meshes are kept. On the CPU a mesh is recognised by its values. On CUDA comparing values
    would wait for the device, so a mesh is recognised by its tensor, unless the tensor was changed in place.

    Args:
        faces: Vertex indices, [F, 3] or [B or 1, F, 3] of integers. Faces of (-1, -1, -1) are padding.

    Returns:
        [B or 1, F + 1, 3] int32: the next edge in the ring of each edge. The last row holds the number of edges that
        are alone in their ring, three times.
    """
    return _known_rings(faces) if is_plain((faces,)) else _edge_rings(faces)


def edges_alone(rings: Tensor) -> int | None:
    """Return the number of edges that are alone in their rings; None where reading it would wait for the device."""
    if readable(rings.device):
        return int(rings[0, -1, 0])
    return rings.__dict__.get("_alone")


@operator
def _edge_rings(faces: Tensor) -> Tensor:
    return _known_rings(faces).clone()  # compiled programs may overwrite their inputs


@fake("_edge_rings")
def _(faces: Tensor) -> Tensor:
    batch, count = (1, *faces.shape)[-3:-1]
    return faces.new_empty((batch, count + 1, 3), dtype=torch.int32)


def _known_rings(faces: Tensor) -> Tensor:
    """Return the kept rings of a known mesh; otherwise find and keep them."""
    with _lock:
        kept = list(_kept)
    known_by_values = readable(faces.device)
    version = -1 if faces.is_inference() else faces._version
    for one in reversed(kept):
        if one.rings.device != faces.device:
            continue
        if known_by_values:
            same = one.faces.shape == faces.shape and one.faces.dtype == faces.dtype and torch.equal(one.faces, faces)
        else:
            same = one.source() is faces and one.version == version >= 0
        if same:
            # On CUDA read once, of a mesh that comes again; not while a graph is captured.
            if not known_by_values and "_alone" not in one.rings.__dict__ and stream_of(faces.device) is not None:
                one.rings.__dict__["_alone"] = int(one.rings[0, -1, 0])
            return one.rings
    rings = _find_rings(faces if faces.dim() == 3 else faces[None])
    copy = faces.clone() if known_by_values else faces[:0]
    with _lock:
        _kept.append(_Kept(copy, weakref.ref(faces), version, rings))
    return rings


@torch.inference_mode(False)  # what is kept may be needed with gradients later
@torch.no_grad()
def _find_rings(faces: Tensor) -> Tensor:
    """Sort the edges of faces [B, F, 3] by their vertices, and link equal ones to rings."""
    batch, count = faces.shape[:2]
    start = faces.long()
    end = start.roll(-1, 2)
    low, high = torch.minimum(start, end), torch.maximum(start, end)
    own = torch.arange(3 * count, device=faces.device).expand(batch, -1)
    # An edge from a vertex to itself has a name of its own; so have the edges of (-1, -1, -1), which is padding. Both
    # vertices have 31 bits, whatever their number, which to read could be to wait for the device.
    name = torch.where(low == high, -1 - own.view(batch, count, 3), (low << 31) + high)
    name, order = name.flatten(1).sort(dim=1, stable=True)
    last = torch.cat((name[:, 1:] != name[:, :-1], torch.ones_like(name[:, :1], dtype=torch.bool)), 1)
    first = torch.where(last.roll(1, 1), own, 0)
    following = torch.where(last, order.gather(1, first.cummax(1).values), order.roll(-1, 1))
    rings = torch.empty_like(order).scatter_(1, order, following)
    alone = (rings == own).sum()
    return torch.cat((rings.view(batch, count, 3), alone.expand(batch, 1, 3)), 1).int()
