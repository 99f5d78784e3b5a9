"""Fewer faces: collapse of edges in the order of quadric errors, by fast-simplification and opengl_decimate."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy import sparse
from scipy.sparse import csgraph
from torch import Tensor

from ....base.requirements import import_library
from ....meshes.bounds import bounding_box
from ...common.geometry.defects import count_defects, first_of_equal_faces
from ...common.geometry.edges import Edges
from .silhouettes import Silhouettes

# Stages of fast-simplification before opengl_decimate: how fast its limit of errors grows (low is exact), the factor by
# which a stage reduces the faces, and whether a stage that ends with too many faces is the last one.
_STAGES = ((3.0, 4.0, False), (3.0, 4.0, True), (2.0, 2.0, True), (5.0, 4.0, False), (2.5, 1.5, False))
_MOST_COMPARED = 100_000  # faces of a surface whose silhouettes decide between all ways
_LEAST_GAIN = 0.98  # error of silhouettes, relative to that of the way before, below which a way is better
_MANY_TANGLES = 0.01  # edges of more than two faces, relative to the faces, beyond which sheets are a way, too
_APART = 3e-6  # distance that keeps the vertices of sheets from being joined, of a surface in [-1, 1]³
FEW_BORDERS = 0.25  # share of the wished faces that a border may take to be kept exactly
_ALMOST_CLOSED = 0.25  # border edges, relative to the root of the number of faces, of a surface with a few small holes
_MOST_OVER = 1.05  # result, relative to the wish, that is accepted


def decimate(vertices: Tensor, faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Reduce a surface of vertices [V, 3] and faces [F, 3] to about ``count`` faces.

    Each vertex goes where the sum of squared distances to the planes of its faces is least (Garland and Heckbert,
    "Surface simplification using quadric error metrics", 1997). A surface with at most a few small holes goes to
    fast-simplification, and, where its limit of errors ends before the number of faces, from there to opengl_decimate.
    Others go to the latter first, which keeps borders: short ones exactly, others on their lines. Another way follows
    if the result has too many faces, is less manifold than the surface, or opens a border; the better one is taken.
    Up to `_MOST_COMPARED` faces all ways are gone, and of those with the least faults the best silhouettes decide.
    opengl_decimate keeps edges of more than two faces, and takes what it needs from all others; where there are many
    such edges, as in levels of games, a further way cuts the surface there first.
    """
    if len(faces) <= count:
        return vertices, faces
    library = import_library("fast_simplification", "to reduce faces")
    center, half = bounding_box(vertices.double())
    points, corners = ((vertices.double() - center) / half).numpy(), faces.int().numpy()
    border, tangled = count_defects(corners)
    best: tuple[tuple[int, ...], float, np.ndarray, np.ndarray] | None = None
    is_open = border > _ALMOST_CLOSED * len(faces) ** 0.5
    judge = Silhouettes(*map(torch.from_numpy, (points, corners))) if len(faces) <= _MOST_COMPARED else None
    stages: tuple[tuple[float, float, bool] | None, ...] = _STAGES if judge else _STAGES[:1]
    surface = points, corners
    ways = [(surface, way) for way in ((None, *stages) if is_open else (*stages, None))]
    if judge and tangled > _MANY_TANGLES * len(faces):
        ways.append((_sheets(points, corners), None))
    for start, way in ways:
        if start is not surface:
            border, tangled = count_defects(start[1])
        found, triangles = start if way is None else _in_stages(library, *start, count, way)
        if len(triangles) > count:
            used, triangles = np.unique(triangles, return_inverse=True)
            is_exact = border < FEW_BORDERS * count
            collapsed, triangles = collapse(found[used], triangles.reshape(-1, 3), count, is_exact, {})
            found, triangles = collapsed["POSITION"], _whole(triangles)
        if not len(triangles):
            continue
        borders, tangles = count_defects(triangles)
        over = len(triangles) - round(_MOST_OVER * count)
        fault = max(0, over), max(0, tangles - tangled), max(0, borders - border)
        error = judge.error(torch.from_numpy(found), torch.from_numpy(triangles)) if judge else 0.0
        if best is None or (fault, error) < (best[0], _LEAST_GAIN * best[1]):
            best = fault, error, found, triangles
        if judge is None and not any(fault):
            break
    if best is None:
        return vertices, faces
    used, triangles = np.unique(best[3], return_inverse=True)
    moved = center + half * torch.from_numpy(best[2][used].astype(np.float64))
    return moved.float(), torch.from_numpy(triangles.reshape(-1, 3)).long()


def collapse(
    points: np.ndarray,
    faces: np.ndarray,
    count: int,
    exact_border: bool,
    attributes: dict[str, np.ndarray],
    locked: list[int] | None = None,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Collapse edges by the library opengl_decimate, which carries attributes [N, C] of points along and keeps seams.

    ``locked`` lists points that stay. Returns the attributes that remain, with the points as "POSITION", and the faces.
    """
    library = import_library("opengl_decimate", "to reduce faces")
    options = library.SimplifyOptions(target_count=count, lock_boundary=exact_border, locked=locked)
    found = library.simplify({"POSITION": points} | attributes, faces.reshape(-1).astype(np.uint32), options)
    return found.attributes, found.indices.reshape(-1, 3).astype(np.int64)


def _sheets(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut a surface at edges that do not join exactly two faces of equal orientation; move the cuts a little apart."""
    corners = torch.from_numpy(faces).long()
    edges = Edges.of(corners, len(points))
    pairs, ends = edges.faces[edges.regular], edges.ends[edges.regular]
    same = corners[pairs][:, :, None] == ends[:, None, :, None]  # [edges, faces, ends, corners]
    joined = (3 * pairs[:, :, None] + same.long().argmax(-1)).transpose(0, 1).reshape(2, -1).numpy()
    graph = sparse.coo_matrix((np.ones(joined.shape[1], bool), tuple(joined)), shape=(corners.numel(),) * 2)
    label = csgraph.connected_components(graph, directed=False)[1]
    first = np.unique(label, return_index=True)[1]
    away = np.random.default_rng(0).uniform(-_APART, _APART, (len(first), 3))
    return points[corners.flatten().numpy()[first]] + away, label.reshape(-1, 3).astype(np.int32)


def _in_stages(
    library: Any, points: np.ndarray, corners: np.ndarray, count: int, way: tuple[float, float, bool]
) -> tuple[np.ndarray, np.ndarray]:
    """Reduce faces by a factor at a time: a sweep that ends at the number leaves the faces after it as they are."""
    patience, factor, ends_early = way
    while len(corners) > count:
        target = max(count, int(len(corners) / factor))
        points, left = library.simplify(points, corners, target_count=target, agg=patience)
        left = _whole(left)
        if len(left) == len(corners):
            break
        corners = left.astype(np.int32)
        if ends_early and len(corners) > _MOST_OVER * target:
            break
    return points, corners


def _whole(triangles: np.ndarray) -> np.ndarray:
    """Leave out faces with two equal corners, and all but one of those with the same three."""
    triangles = triangles[(triangles != np.roll(triangles, 1, 1)).all(1)]
    kept: np.ndarray = triangles[first_of_equal_faces(torch.from_numpy(triangles).long()).numpy()]
    return kept
