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

from ..warp.registration import is_plain, operator


class _Kept(NamedTuple):
    """The rings of a mesh seen before."""

    faces: Tensor  # a copy, on the CPU
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


@operator
def _edge_rings(faces: Tensor) -> Tensor:
    return _known_rings(faces).clone()  # compiled programs may overwrite their inputs


@torch.library.register_fake("neural_renderer::_edge_rings")
def _(faces):  # type: ignore[no-untyped-def]
    batch, count = (1, *faces.shape)[-3:-1]
    return faces.new_empty((batch, count + 1, 3), dtype=torch.int32)


def _known_rings(faces: Tensor) -> Tensor:
    """Return the kept rings of a known mesh; otherwise find and keep them."""
    with _lock:
        kept = list(_kept)
    on_cpu = faces.device.type == "cpu"
    version = -1 if faces.is_inference() else faces._version
    for one in reversed(kept):
        if one.rings.device != faces.device:
            continue
        if on_cpu:
            same = one.faces.shape == faces.shape and one.faces.dtype == faces.dtype and torch.equal(one.faces, faces)
        else:
            same = one.source() is faces and one.version == version >= 0
        if same:
            return one.rings
    rings = _find_rings(faces if faces.dim() == 3 else faces[None])
    copy = faces.clone() if on_cpu else faces[:0]
    with _lock:
        _kept.append(_Kept(copy, weakref.ref(faces), version, rings))
    return rings


@torch.no_grad()
def _find_rings(faces: Tensor) -> Tensor:
    """Sort the edges of faces [B, F, 3] by their vertices, and link equal ones to rings."""
    batch, count = faces.shape[:2]
    start = faces.long()
    end = start.roll(-1, 2)
    low, high = torch.minimum(start, end), torch.maximum(start, end)
    vertices = int(high.max()) + 2 if high.numel() else 1
    image = torch.arange(batch, device=faces.device)[:, None, None]
    own = torch.arange(batch * count * 3, device=faces.device)
    # An edge from a vertex to itself gets a unique name, and so do the edges of padding, (-1, -1, -1).
    name = torch.where(low == high, -1 - own.view(batch, count, 3), (image * vertices + low + 1) * vertices + high)
    name, order = name.flatten().sort(stable=True)
    last = torch.cat((name[1:] != name[:-1], name.new_ones(min(1, len(name)), dtype=torch.bool)))
    first = torch.where(torch.cat((last[-1:], last[:-1])), torch.arange(len(name), device=faces.device), 0)
    following = torch.where(last, order[first.cummax(0).values], order.roll(-1))
    rings = torch.empty_like(order)
    rings[order] = following
    alone = (rings == own).sum()
    rings = (rings.view(batch, count * 3) - image[:, 0] * count * 3).view(batch, count, 3)
    return torch.cat((rings, alone.expand(batch, 1, 3)), 1).int()
