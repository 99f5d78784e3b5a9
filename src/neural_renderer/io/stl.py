"""STL files, as text and binary.

Source: 3D Systems, StereoLithography Interface Specification, 1989.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .files import read_bytes, read_text
from .polygon_meshes import checked_points, parsed_numbers

_HEADER, _RECORD = 84, 50  # bytes
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_BLANK = b"\xef\xbb\xbf \t\r\n"  # some programs begin with a space, or with the mark of UTF-8
_VERTEX = re.compile(r"^[ \t]*vertex\b(.*)$", re.MULTILINE | re.IGNORECASE)


def read_stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read an STL file: distinct vertices [V, 3], and faces [F, 3]. Normals are ignored.

    Bytes after the last triangle of a binary file are ignored. ValueError: The file is damaged or has no faces.
    """
    data = read_bytes(path)
    count = int.from_bytes(data[_HEADER - 4 : _HEADER], "little")
    # Text has letters in the place of the count, which are a number too large for any file.
    if len(data) >= _HEADER and _HEADER + _RECORD * count <= len(data):
        points = np.frombuffer(data, _TRIANGLE, count, _HEADER)["corners"].reshape(-1, 3).astype(np.float32)
    elif (is_text := data[:_HEADER].lstrip(_BLANK)[:5].lower() == b"solid") or b"\0" in data[:5]:  # UTF-16, too
        points = _text(path)
        if not len(points) and is_text and b"\0" in data:
            expected = f"vertices as text, or {count} triangles of {_RECORD} bytes after the first {_HEADER}"
            raise ValueError(f"{path}: expected {expected}, got {len(data)} bytes; the file is cut or no STL")
    elif len(data) < _HEADER:
        raise ValueError(f"{path}: expected STL, which begins with solid or has {_HEADER} bytes, got {len(data)} bytes")
    else:
        expected = f"{count} triangles of {_RECORD} bytes after the first {_HEADER}"
        raise ValueError(f"{path}: expected {expected}, got {len(data) - _HEADER} bytes; the file is cut or no STL")
    if not len(points):
        raise ValueError(f"{path}: expected faces, got 0 vertices but no faces")
    return _join_equal(checked_points(path, points))


def _text(path: Path) -> np.ndarray:
    """Return the corners of all triangles, [3 F, 3] float64."""
    rows = [line.split() for line in _VERTEX.findall(read_text(path))]
    points = parsed_numbers(path, rows, 3, "vertex")
    if len(points) % 3:
        raise ValueError(f"{path}: expected three vertices for each face, got {len(points)} vertices; the file is cut")
    return points


def _join_equal(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge equal vertices; keep the order of first appearance. Return them, and the faces."""
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return points[np.sort(first)], rank[inverse.reshape(-1, 3)]
