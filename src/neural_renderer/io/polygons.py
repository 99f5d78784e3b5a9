"""Polygons into triangles: a fan where that is right, ears cut off where the polygon is concave."""

from __future__ import annotations

import numpy as np


def triangulate(points: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split polygons into triangles.

    Args:
        points: [V, 3] float positions.
        corners: [C] int, the vertex of each corner, polygon after polygon.
        sizes: [P] int, corners of each polygon, at least 3.

    Returns:
        The triangles as positions in ``corners`` ([F, 3] int, in the polygons' order) and the polygon of each ([F]).
        A polygon with corners 0, 1, ..., n-1 becomes the fan (0, 1, 2), (0, 2, 3), ...; one for which that fan has a
        triangle turned over (it is concave) is cut by its ears instead.
    """
    counts = sizes - 2
    starts, offsets = np.cumsum(sizes) - sizes, np.cumsum(counts) - counts
    triangles = np.empty((counts.sum(), 3), dtype=np.int64)
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        steps = np.arange(1, size - 1)
        fan = np.stack([np.zeros_like(steps), steps, steps + 1], axis=1)
        triangles[offsets[chosen][:, None] + np.arange(size - 2)] = starts[chosen][:, None, None] + fan
        if size == 3:
            continue
        outlines = points[corners[starts[chosen][:, None] + np.arange(size)]]
        spokes = outlines[:, 1:] - outlines[:, :1]
        areas = np.cross(spokes[:, :-1], spokes[:, 1:])
        normals = areas.sum(axis=1)
        length = np.linalg.norm(normals, axis=1)
        signed = np.einsum("ntk,nk->nt", areas, normals) / np.maximum(length, 1e-300)[:, None]
        for which in np.flatnonzero(signed.min(axis=1) < -1e-6 * length):
            polygon = chosen[which]
            ears = _cut_ears(outlines[which], normals[which])
            triangles[offsets[polygon] : offsets[polygon] + size - 2] = starts[polygon] + ears
    return triangles, np.repeat(np.arange(len(sizes)), counts)


def _cut_ears(outline: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The [n - 2, 3] triangles of one polygon [n, 3] float, flattened along its normal."""
    drop = int(np.abs(normal).argmax())
    flat = np.delete(outline, drop, axis=1)
    if (normal[drop] < 0) != (drop == 1):  # dropping y mirrors the plane
        flat = flat * [-1, 1]
    left = list(range(len(flat)))
    ears = []
    while len(left) > 3:
        at = next((i for i in range(len(left)) if _is_ear(flat, left, i)), 0)  # none: it crosses itself, so any
        ears.append((left[at - 1], left[at], left[(at + 1) % len(left)]))
        del left[at]
    return np.array([*ears, left])


def _is_ear(flat: np.ndarray, left: list[int], at: int) -> bool:
    a, b, c = triangle = flat[[left[at - 1], left[at], left[(at + 1) % len(left)]]]
    if _cross(b - a, c - b) <= 0:
        return False
    others = flat[left]
    # A vertex that only touches a corner (bridges to holes repeat vertices) does not lie in the ear.
    others = others[~(others[:, None] == triangle).all(axis=2).any(axis=1)]
    inside = (_cross(b - a, others - a) >= 0) & (_cross(c - b, others - b) >= 0) & (_cross(a - c, others - c) >= 0)
    return not inside.any()


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
