"""Parser of OBJ files: vertices, triangulated faces, texture coordinates and names of materials."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import fits_float32, read_text, short
from .polygons import triangulate

_MOST = 2**31  # bound of indices


@dataclass
class ObjFile:
    """Content of an OBJ file, in the file's order of vertices and faces."""

    path: Path
    vertices: np.ndarray  # [V, 3] float64
    colors: np.ndarray  # [V, 3] float64 in [0, 1]; NaN for a vertex without a colour
    faces: np.ndarray  # [F, 3] int64, indices from 0
    uv: np.ndarray  # [F, 3, 2] float64; NaN for a corner without texture coordinates
    normals: np.ndarray | None  # [F, 3, 3] float64, unit normals of the corners; 0 for a corner without one
    material: np.ndarray  # [F] int, index into ``names``, or −1
    names: list[str]  # names of materials
    libraries: list[str]  # text after each ``mtllib``


def read_obj(path: Path, with_uv: bool) -> ObjFile:
    """Read an OBJ file and triangulate its polygons. Points, lines, curves and groups are ignored.

    Without ``with_uv``, texture coordinates and normals are ignored, even if they are invalid.
    """
    parser = _Parser(path)
    text = read_text(path)
    for number, line in _statements(text):
        try:
            parser.statement(number, line)
        except (ValueError, IndexError) as error:
            reason = str(error) if isinstance(error, _OutOfRange) else f"cannot read {short(line.strip())}"
            raise ValueError(f"{path}, line {number}: {reason}") from None
    if not parser.sizes:
        empty = "" if text.strip() else " (it is empty)"
        raise ValueError(f"{path}: expected faces, got {len(parser.positions)} vertices but no faces{empty}")
    return parser.finish(with_uv)


class _OutOfRange(ValueError):
    """Error of an index, with a message for the user."""


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Iterate over numbered lines, from 1; a backslash at the end of a line joins it with the next."""
    parts: list[str] = []
    first = 0
    for number, line in enumerate(text.split("\n"), 1):
        if line.endswith("\\") and not line.lstrip().startswith("#"):
            parts.append(line[:-1])
            first = first or number
        elif parts:
            yield first, " ".join([*parts, line])
            parts, first = [], 0
        else:
            yield number, line
    if parts:
        yield first, " ".join(parts)


def _normal(words: list[str]) -> tuple[float, float, float]:
    """Parse a normal and scale it to 1; 0 for what is none, because programs write all sorts of them."""
    try:
        x, y, z = map(float, words)
    except ValueError:
        return 0.0, 0.0, 0.0
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length) if 0 < length < math.inf else (0.0, 0.0, 0.0)


def _normal_index(text: str, known: int) -> int:
    """Convert the index of a normal to one from 0; −1 if there is none, or if it is wrong."""
    try:
        index = int(text) if text else 0
    except ValueError:
        return -1
    return index - 1 if 0 < index < _MOST else max(known + index, -1) if index < 0 else -1


class _Parser:
    """Collects the statements of a file; `finish` makes an `ObjFile` of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.positions: list[tuple[float, float, float]] = []
        self.position_lines: list[int] = []
        self.colors: dict[int, tuple[float, float, float]] = {}
        self.texture: list[tuple[float, float]] = []
        # Indices from 0, of the corners of all polygons in a row; −1 for a corner without texture coordinate.
        self.corners: list[int] = []
        self.texture_corners: list[int] = []
        self.normals: list[tuple[float, float, float]] = []
        self.normal_corners: list[int] = []
        self.sizes: list[int] = []
        self.face_lines: list[int] = []
        self.material: list[int] = []
        self.current = -1
        self.names: dict[str, int] = {}
        self.libraries: list[str] = []

    def statement(self, number: int, line: str) -> None:
        """Parse a line."""
        words = line.split()
        keyword = words[0] if words else ""
        if keyword == "f":
            self._face(number, words)
        elif keyword == "v":
            self._vertex(number, words)
        elif keyword == "vt":
            self.texture.append((float(words[1]), float(words[2]) if words[2:] and words[2][0] != "#" else 0.0))
        elif keyword == "vn":
            self.normals.append(_normal(words[1:4]))
        elif keyword in ("usemtl", "mtllib"):
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            if keyword == "mtllib":
                self.libraries.append(name)
            else:
                self.current = self.names.setdefault(name, len(self.names))

    def _vertex(self, number: int, words: list[str]) -> None:
        if len(words) > 6 and not any(word[0] == "#" for word in words[4:7]):
            self.colors[len(self.positions)] = (float(words[4]), float(words[5]), float(words[6]))
        self.positions.append((float(words[1]), float(words[2]), float(words[3])))
        self.position_lines.append(number)

    def _face(self, number: int, words: list[str]) -> None:
        count = 0
        vertices, textures = len(self.positions), len(self.texture)
        for word in words[1:]:
            if word[0] == "#":
                break
            vertex, _, rest = word.partition("/")
            texture, _, normal = rest.partition("/")
            self.corners.append(self._index(int(vertex), vertices, "vertex"))
            self.texture_corners.append(self._index(int(texture), textures, "texture coordinate") if texture else -1)
            self.normal_corners.append(_normal_index(normal, len(self.normals)))
            count += 1
        if count < 3:
            raise _OutOfRange(f"expected a face of at least three corners, got {count}")
        self.sizes.append(count)
        self.face_lines.append(number)
        self.material.append(self.current)

    @staticmethod
    def _index(index: int, known: int, what: str) -> int:
        """Convert an index of the file to one from 0. `finish` checks positive ones: their target may come later."""
        if index > 0:
            return index - 1
        if index == 0 or known + index < 0:
            limit = f"not 0 nor below -{known}" if known else f"above 0, because no {what} comes before it"
            raise _OutOfRange(f"expected a {what} index that is {limit}, got {short(index)}")
        return known + index

    def finish(self, with_uv: bool) -> ObjFile:
        """Check indices, triangulate polygons and return the content."""
        vertices = np.array(self.positions, dtype=np.float64).reshape(-1, 3)
        bad = ~fits_float32(vertices).all(axis=1)
        if bad.any():
            line = self.position_lines[int(bad.argmax())]
            raise ValueError(
                f"{self.path}, line {line}: expected finite coordinates that float32 can hold, got "
                f"{vertices[bad][0].tolist()}"
            )
        corners, sizes = np.array(self.corners), np.array(self.sizes)
        self._check(corners, len(vertices), "vertex")
        triangles, polygon = triangulate(vertices, corners, sizes)
        uv = np.full((len(triangles), 3, 2), np.nan)
        if with_uv and self.texture:  # indices of coordinates are ignored in a file without coordinates
            texture_corners = np.array(self.texture_corners)
            self._check(texture_corners, len(self.texture), "texture coordinate")
            # −1, a corner without coordinates, reads the extra entry at the end.
            uv = np.array([*self.texture, (np.nan, np.nan)])[texture_corners[triangles]]
        normals = None
        if with_uv and self.normals:
            known = np.array([*self.normals, (0.0, 0.0, 0.0)])
            normal_corners = np.array(self.normal_corners)[triangles]
            normals = known[np.where(normal_corners < len(self.normals), normal_corners, -1)]
        colors = np.full(vertices.shape, np.nan)
        if self.colors:
            colors[list(self.colors)] = list(self.colors.values())
            colors[~np.isfinite(colors).all(axis=1)] = np.nan
            if np.nanmax(colors, initial=0) > 1:  # some programs write 0 to 255
                colors /= 255
            colors = colors.clip(0, 1)
        faces, material = corners[triangles], np.array(self.material)[polygon]
        return ObjFile(self.path, vertices, colors, faces, uv, normals, material, list(self.names), self.libraries)

    def _check(self, corners: np.ndarray, known: int, what: str) -> None:
        """Raise ValueError if an index is not below ``known``."""
        bad = corners >= known
        if bad.any():
            at = int(bad.argmax())
            line, index = np.repeat(self.face_lines, self.sizes)[at], short(int(corners[at]) + 1)
            reason = f"expected a {what} index up to {known}, got {index}"
            if not known:
                reason = f"{what} {index} is used, but the file defines none"
            raise ValueError(f"{self.path}, line {line}: {reason}")
