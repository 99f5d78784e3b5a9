"""Sibling half-edges: the edges of faces that have the same two vertices, found once for each mesh.

Edge k of face f, its half-edge from corner k to the next, has the number 3 f + k. The half-edges between the same two
vertices form a cycle: each names the next one, its sibling, and the last names the first (Dyedov et al., "AHF:
array-based half-facet data structure for mixed-dimensional and non-manifold meshes", 2014). A boundary edge, which no
other face shares, names itself.
"""

from __future__ import annotations

import collections
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from ...base import arrivals, private
from ...base.one_line import OneLine
from ..warp.elementwise import equal
from ..warp.launch import stream_of
from ..warp.layout import readable
from ..warp.registration import fake, of_constants, operator


@dataclass(frozen=True, repr=False)
class HalfEdges(OneLine):
    """The half-edges of a mesh."""

    siblings: Tensor  # sibling of each half-edge, [B or 1, F, 3] int32
    boundary: int  # number of boundary edges; -1 on CUDA, where reading it would synchronise


@dataclass
class _Cached:
    """The half-edges of a mesh seen before."""

    faces: Tensor  # a copy, where values can be compared
    source: weakref.ref[Tensor]
    version: tuple[int, ...] | None
    half_edges: HalfEdges
    boundary: tuple[Tensor, Callable[[], bool]] | None  # on its way from CUDA, as from `send`


_cache: collections.deque[_Cached] = collections.deque(maxlen=8)
_captured = WeakTensorKeyDictionary()  # half-edges that a CUDA graph reads, kept as long as its faces
_lock = threading.Lock()


def find_half_edges(faces: Tensor) -> HalfEdges:
    """Find the sibling half-edges of faces by their vertex indices, [F, 3] or [B or 1, F, 3]; (-1, -1, -1) is padding.

    The results for the last eight meshes are cached. On the CPU a mesh is recognised by its values. On CUDA comparing
    values would synchronise, so a mesh is recognised by its tensor, unless the tensor was changed in place.
    """
    return of_constants(_cached_half_edges, faces) or HalfEdges(_sibling_half_edges(faces), -1)


def count_boundary(half_edges: HalfEdges) -> int | None:
    """Count the boundary edges; None on CUDA, where reading the number would synchronise."""
    if half_edges.boundary < 0 and readable(half_edges.siblings.device):
        return int(_are_boundary(half_edges.siblings).sum())
    return None if half_edges.boundary < 0 else half_edges.boundary


@operator
def _sibling_half_edges(faces: Tensor) -> Tensor:
    return _cached_half_edges(faces).siblings.clone()  # compiled programs may overwrite their inputs


@fake(_sibling_half_edges)
def _(faces: Tensor) -> Tensor:
    return faces.new_empty((1, *faces.shape)[-3:], dtype=torch.int32)


def _cached_half_edges(faces: Tensor) -> HalfEdges:
    """Return the cached half-edges of a known mesh; otherwise find and cache them."""
    with _lock:
        known = list(_cache)
    known_by_values = readable(faces.device)
    version = private.version_of(faces)
    for one in reversed(known):
        if one.half_edges.siblings.device != faces.device:
            continue
        if known_by_values:
            same = one.faces.shape == faces.shape and one.faces.dtype == faces.dtype and equal(one.faces, faces)
        else:
            same = version is not None and one.source() is faces and one.version == version
        if same:
            if stream_of(faces.device) is None:
                _captured[faces] = one.half_edges
            if one.boundary is not None and one.boundary[1]():
                one.half_edges, one.boundary = replace(one.half_edges, boundary=int(one.boundary[0])), None
            return one.half_edges
    following = _link_siblings(faces if faces.dim() == 3 else faces[None])
    boundary = _are_boundary(following).sum()
    half_edges = HalfEdges(following, int(boundary) if known_by_values else -1)
    if stream_of(faces.device) is None:
        return half_edges  # a replay computes them
    copy, sent = (faces.clone(), None) if known_by_values else (faces[:0], arrivals.send(boundary))
    with _lock:
        _cache.append(_Cached(copy, weakref.ref(faces), version, half_edges, sent))
    return half_edges


def _are_boundary(following: Tensor) -> Tensor:
    index = torch.arange(3 * following.shape[1], dtype=torch.int32, device=following.device)
    return following == index.view(-1, 3)


@torch.inference_mode(False)  # cached values may be needed with gradients later
@torch.no_grad()
def _link_siblings(faces: Tensor) -> Tensor:
    """Sort the half-edges of faces [B, F, 3] by their vertices, and link equal ones to a cycle."""
    batch, count = faces.shape[:2]
    start = faces.long()
    end = start.roll(-1, 2)
    low, high = torch.minimum(start, end), torch.maximum(start, end)
    index = torch.arange(3 * count, device=faces.device).expand(batch, -1)
    # Degenerate and padded edges get unique keys. Keys are 31 + 31 bits: reading V could synchronise with the GPU.
    name = torch.where(low == high, -1 - index.view(batch, count, 3), (low << 31) + high)
    name, order = name.flatten(1).sort(dim=1, stable=True)
    last = torch.cat((name[:, 1:] != name[:, :-1], torch.ones_like(name[:, :1], dtype=torch.bool)), 1)
    first = torch.where(last.roll(1, 1), index, 0)
    following = torch.where(last, order.gather(1, first.cummax(1).values), order.roll(-1, 1))
    siblings = torch.empty_like(order).scatter_(1, order, following)
    return siblings.view(batch, count, 3).int()
