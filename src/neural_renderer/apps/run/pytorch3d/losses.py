"""Losses of meshes and points: those of this package, averaged over the batch, and the chamfer distance."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ....meshes.topology import Topology
from ....optim import losses
from .meshes import Meshes


def mesh_edge_loss(meshes: Meshes, target_length: float = 0.0) -> Tensor:
    """Compute the mean of (length − target)² over edges, averaged over meshes."""

    def of_one(verts: Tensor, faces: Tensor) -> Tensor:
        start, end = verts[Topology.of(faces).edges].unbind(1)
        return ((start - end).norm(dim=-1) - target_length).square().mean()

    return _mean(meshes, of_one if target_length else losses.edge_length)


def mesh_normal_consistency(meshes: Meshes) -> Tensor:
    """Compute the mean of 1 − cos over pairs of adjacent faces, averaged over meshes."""
    return _mean(meshes, losses.normal_consistency)


def mesh_laplacian_smoothing(meshes: Meshes, method: str = "uniform") -> Tensor:
    """Compute the mean distance of vertices to the centroid of their neighbours, averaged over meshes."""
    if method != "uniform":
        raise NotImplementedError(
            f"mesh_laplacian_smoothing(method={method!r}): neural-renderer run has 'uniform' only"
        )
    return _mean(meshes, lambda verts, faces: losses.laplacian(verts, faces, squared=False))


def chamfer_distance(
    x: Tensor, y: Tensor, x_lengths: Any = None, y_lengths: Any = None, x_normals: Any = None, y_normals: Any = None,
    weights: Any = None, batch_reduction: Any = "mean", point_reduction: Any = "mean", norm: int = 2,
    **unknown: Any,
) -> tuple[Tensor, Tensor | None]:  # fmt: skip
    """Compute the squared distance (norm 2) or the sum of coordinates (norm 1) to the nearest point of the other set.

    Returns it, added in both directions, and 1 − |cos| of the normals of nearest points, or None.
    """
    given = {"x_lengths": x_lengths, "y_lengths": y_lengths, "weights": weights}
    wrong = [name for name, value in {**given, **unknown}.items() if value is not None and value is not False]
    if wrong or norm not in (1, 2) or point_reduction not in ("mean", "sum"):
        raise NotImplementedError(f"chamfer_distance({', '.join(wrong) or 'norm'}): not in neural-renderer run")
    distance, turn = _one_way(x, y, x_normals, y_normals, norm)
    back, turned = _one_way(y, x, y_normals, x_normals, norm)
    reduced = [_reduced(a, batch_reduction, point_reduction) for a in (distance, back)]
    if x_normals is None or y_normals is None:
        return reduced[0] + reduced[1], None
    turns = [_reduced(a, batch_reduction, point_reduction) for a in (turn, turned)]
    return reduced[0] + reduced[1], turns[0] + turns[1]


def _one_way(x: Tensor, y: Tensor, x_normals: Any, y_normals: Any, norm: int) -> tuple[Tensor, Tensor]:
    """Compute the distance of points [N, P, D] to the nearest ones of [N, Q, D], and 1 − |cos| of normals, [N, P]."""
    pairs = zip(x.detach().cpu().numpy(), y.detach().cpu().numpy(), strict=True)
    found = np.stack([cKDTree(other).query(points, p=norm)[1] for points, other in pairs])
    index = torch.from_numpy(found).to(x.device)[..., None]
    offset = x - y.gather(1, index.expand(-1, -1, y.shape[2]))
    distance = offset.square().sum(-1) if norm == 2 else offset.abs().sum(-1)
    if x_normals is None or y_normals is None:
        return distance, distance
    cosine = torch.nn.functional.cosine_similarity(x_normals, y_normals.gather(1, index.expand(-1, -1, 3)), -1, 1e-6)
    return distance, 1 - cosine.abs()


def _reduced(each: Tensor, batch: str | None, points: str) -> Tensor:
    total = each.mean(1) if points == "mean" else each.sum(1)
    return total if batch is None else total.mean() if batch == "mean" else total.sum()


def _mean(meshes: Meshes, loss: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    pairs = zip(meshes.verts_list(), meshes.faces_list(), strict=True)
    return torch.stack([loss(verts, faces) for verts, faces in pairs]).mean()
