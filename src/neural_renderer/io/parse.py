"""The statements of an OBJ file: positions, faces as triangles, texture coordinates, names of materials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .files import fits_float32, read_text, short
from .polygons import triangulate


@dataclass
class ObjFile:
    """What an OBJ file holds, in the file's order of vertices and faces.

    ``vertices`` [V, 3] float64; ``colours`` [V, 3] float64 in [0, 1], NaN where a vertex has none; ``faces`` [F, 3]
    int64 from 0; ``uv`` [F, 3, 2] float64, NaN where a corner has none; ``material`` [F] int, an index into
    ``names`` or -1; ``libraries`` the text after each ``mtllib``.
    """

    path: Path
    vertices: np.ndarray
    colours: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    material: np.ndarray
    names: list[str]
    libraries: list[str]


def read_obj(path: Path, with_uv: bool) -> ObjFile:
    """Read an OBJ file; polygons become triangles, points, lines, curves, groups and normals are passed over.

    ``with_uv=False`` passes over texture coordinates too, right or wrong. Raises ValueError, naming file and line,
    for a statement that cannot be read, a vertex that is NaN or infinite, a face with fewer than three corners or an
    index out of range, and for a file without faces.
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
    """An index error whose text is ready for the reader."""


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Lines with their numbers from 1; a backslash at the end of a line joins it with the next."""
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


class _Parser:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.positions: list[tuple[float, float, float]] = []
        self.position_lines: list[int] = []
        self.colours: dict[int, tuple[float, float, float]] = {}
        self.texture: list[tuple[float, float]] = []
        # Corners of all polygons one after the other: vertex and texture coordinate, from 0, the latter -1 if absent.
        self.corners: list[int] = []
        self.texture_corners: list[int] = []
        self.sizes: list[int] = []
        self.face_lines: list[int] = []
        self.material: list[int] = []
        self.current = -1
        self.names: dict[str, int] = {}
        self.libraries: list[str] = []

    def statement(self, number: int, line: str) -> None:
        words = line.split()
        keyword = words[0] if words else ""
        if keyword == "f":
            self._face(number, words)
        elif keyword == "v":
            self._vertex(number, words)
        elif keyword == "vt":
            self.texture.append((float(words[1]), float(words[2]) if words[2:] and words[2][0] != "#" else 0.0))
        elif keyword in ("usemtl", "mtllib"):
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
            if keyword == "mtllib":
                self.libraries.append(name)
            else:
                self.current = self.names.setdefault(name, len(self.names))

    def _vertex(self, number: int, words: list[str]) -> None:
        if len(words) > 6 and not any(word[0] == "#" for word in words[4:7]):
            self.colours[len(self.positions)] = (float(words[4]), float(words[5]), float(words[6]))
        self.positions.append((float(words[1]), float(words[2]), float(words[3])))
        self.position_lines.append(number)

    def _face(self, number: int, words: list[str]) -> None:
        count = 0
        vertices, textures = len(self.positions), len(self.texture)
        for word in words[1:]:
            if word[0] == "#":
                break
            vertex, _, rest = word.partition("/")
            texture = rest.partition("/")[0]
            self.corners.append(self._index(int(vertex), vertices, "vertex"))
            self.texture_corners.append(self._index(int(texture), textures, "texture coordinate") if texture else -1)
            count += 1
        if count < 3:
            raise _OutOfRange(f"expected a face of at least three corners, got {count}")
        self.sizes.append(count)
        self.face_lines.append(number)
        self.material.append(self.current)

    @staticmethod
    def _index(index: int, known: int, what: str) -> int:
        """From 0; a positive index may be defined further down, so `finish` compares it with the total."""
        if index > 0:
            return index - 1
        if index == 0 or known + index < 0:
            limit = f"not 0 nor below -{known}" if known else f"above 0, because no {what} comes before it"
            raise _OutOfRange(f"expected a {what} index that is {limit}, got {short(index)}")
        return known + index

    def finish(self, with_uv: bool) -> ObjFile:
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
        if with_uv and self.texture:  # a file that numbers coordinates but has none is taken to have none
            texture_corners = np.array(self.texture_corners)
            self._check(texture_corners, len(self.texture), "texture coordinate")
            # One more entry than the file has, so that -1, a corner without coordinates, finds NaN.
            uv = np.array([*self.texture, (np.nan, np.nan)])[texture_corners[triangles]]
        colours = np.full(vertices.shape, np.nan)
        if self.colours:
            colours[list(self.colours)] = list(self.colours.values())
            colours[~np.isfinite(colours).all(axis=1)] = np.nan
            if np.nanmax(colours, initial=0) > 1:  # some programs write 0 to 255
                colours /= 255
            colours = colours.clip(0, 1)
        return ObjFile(
            path=self.path,
            vertices=vertices,
            colours=colours,
            faces=corners[triangles],
            uv=uv,
            material=np.array(self.material)[polygon],
            names=list(self.names),
            libraries=self.libraries,
        )

    def _check(self, corners: np.ndarray, known: int, what: str) -> None:
        bad = corners >= known
        if bad.any():
            at = int(bad.argmax())
            line = np.repeat(self.face_lines, self.sizes)[at]
            limit = f"up to {known}" if known else f"of a {what} in the file"
            raise ValueError(
                f"{self.path}, line {line}: expected a {what} index {limit}, got {short(int(corners[at]) + 1)}"
            )
