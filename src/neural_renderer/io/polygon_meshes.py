"""Common parts of readers of polygons: checks of vertices and corners, triangulation, the range of colours."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .files import fits_float32, short, warn
from .obj.polygons import triangulate

_BLOCK = 1 << 16  # polygons of a block that is triangulated together
_BRIGHT = 2.0  # colours up to here are meant as 0 … 1


class Triangles(NamedTuple):
    """Triangles of polygons."""

    faces: np.ndarray  # [F, 3] int32, indices of vertices
    corner: np.ndarray | None  # [F, 3], indices into the corners of all polygons; None if all polygons are triangles
    polygon: np.ndarray | None  # [F], the polygon of each triangle; None in the same case

    def of_corners(self, values: np.ndarray) -> np.ndarray:
        """Return values of the corners of all polygons, [C, …], at the corners of the triangles, [F, 3, …]."""
        return values.reshape(-1, 3, *values.shape[1:]) if self.corner is None else values[self.corner]

    def of_polygons(self, values: np.ndarray) -> np.ndarray:
        """Return values of the polygons, [P, …], for each triangle, [F, …]."""
        return values if self.polygon is None else values[self.polygon]


def parsed_numbers(path: Path, rows: list[list[str]], count: int, what: str) -> np.ndarray:
    """Convert the first ``count`` words of each row to float64, [rows, count]; ValueError: A word is no number."""
    try:
        return np.array([row[:count] for row in rows], np.float64).reshape(len(rows), count)
    except ValueError:
        number = next(number for number, row in enumerate(rows) if not _are_numbers(row[:count], count))
        got = short(" ".join(rows[number][:count]))
        raise ValueError(f"{path}: expected {count} numbers in {what} {number}, got {got}") from None


def _are_numbers(words: list[str], count: int) -> bool:
    try:
        return len([float(word) for word in words]) == count
    except ValueError:
        return False


def checked_points(path: Path, points: np.ndarray) -> np.ndarray:
    """Return vertices [V, 3], if float32 can hold them; raise ValueError otherwise."""
    points = points if points.dtype in (np.float32, np.float64) else points.astype(np.float64)
    total = float(np.einsum("ij->", points)) if points.dtype == np.float32 else np.inf
    if not np.isfinite(total):
        bad = int((~fits_float32(points)).sum())
        if bad:
            raise ValueError(f"{path}: expected finite vertices that float32 can hold, got {bad} bad numbers")
    return points


def split_polygons(
    path: Path, points: np.ndarray, corners: np.ndarray, sizes: np.ndarray, with_sources: bool = True
) -> Triangles:
    """Split polygons into triangles; ``sizes`` [P] are the numbers of their ``corners`` [C], any real numbers.

    Polygons of fewer than three corners are left out, with a warning. Without ``with_sources``, only the faces are
    found. ValueError: A corner is no vertex, or there are no triangles.
    """
    if len(corners):
        low, high = float(corners.min()), float(corners.max())
        if not (low >= 0 and high < len(points)):
            got = f"{low if not low >= 0 else high:g}"
            raise ValueError(f"{path}: expected indices of its {len(points)} vertices, counted from 0, got {got}")
        if corners.dtype.kind == "f" and (corners != np.floor(corners)).any():
            wrong = corners[corners != np.floor(corners)][0]
            raise ValueError(f"{path}: expected whole numbers as indices of vertices, got {wrong:g}")
    corners = corners.astype(np.int32 if len(points) < 2**31 else np.int64, copy=False)
    if (sizes == 3).all():
        triangles = Triangles(corners.reshape(-1, 3), None, None)
    else:
        triangles = _split(path, points, corners, sizes, with_sources)
    if not len(triangles.faces):
        raise ValueError(f"{path}: expected faces, got {len(points)} vertices but no faces")
    return triangles


def _split(path: Path, points: np.ndarray, corners: np.ndarray, sizes: np.ndarray, with_sources: bool) -> Triangles:
    small = int((sizes < 3).sum())
    if small:
        warn(f"{path}: {small} faces of fewer than three corners are left out")
    total = int(sizes.sum(dtype=np.int64)) - 2 * len(sizes) + int((2 - sizes[sizes < 3].astype(np.int64)).sum())
    faces = np.empty((total, 3), corners.dtype)
    corner, polygon = (np.empty((total, 3), np.int64), np.empty(total, np.int64)) if with_sources else (None, None)
    begin = place = 0
    for first in range(0, len(sizes), _BLOCK):
        counts = sizes[first : first + _BLOCK].astype(np.int64)
        places = place + np.arange(counts.sum())
        place += len(places)
        chosen = np.flatnonzero(counts >= 3)
        if len(chosen) < len(counts):
            places = places[np.repeat(counts >= 3, counts)]
        triangles, number = triangulate(points, corners[places], counts[chosen])
        part = slice(begin, begin + len(triangles))
        begin = part.stop
        faces[part] = corners[places[triangles]]
        if corner is not None and polygon is not None:
            corner[part], polygon[part] = places[triangles], first + chosen[number]
    return Triangles(faces, corner, polygon)


def unit_colors(path: Path, colors: np.ndarray, kind: str) -> np.ndarray:
    """Convert colours to [0, 1] float32 by their type in the file, "u1", "u2", "f4" and so on.

    Bytes end at 255 and 16 bits at 65535. Other types have no range of their own: they end at 1 if they are floats up
    to about 1, else at 255, or at 65535 if a value is larger. A warning reports such a guess.
    """
    if kind in ("u1", "i1"):
        return (colors.astype(np.int64) & 255).astype(np.float32) / np.float32(255)
    values = np.nan_to_num(colors.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    most = float(values.max(initial=0))
    is_float, is_short = kind[0] == "f", kind == "u2"
    end = 1.0 if is_float and most <= _BRIGHT else 255.0 if most <= 255 else 65535.0
    if is_float != (end == 1.0) or (is_short and 0 < most <= 255) or (end > 255 and not is_short):
        warn(f"{path}: its colours reach {most:g}; they are read as 0 … {end:g}")
    return (values / np.float32(end)).clip(0, 1)
