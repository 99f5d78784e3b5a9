"""Meshes in PLY files: vertices, polygons and strips, with colours and images."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import fits_float32, read_bytes, short, warn
from ..image_formats.pictures import PictureSum
from ..images import load_image
from ..named_files import find_file
from ..polygon_meshes import Triangles, checked_points, split_polygons, unit_colors
from ..surface_colors import SurfaceColors
from .header import read_header
from .table import Table, read_tables

_CORNERS = ("vertex_indices", "vertex_index")
_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"), ("texcoord_u", "texcoord_v"))
_COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_IMAGE = re.compile(r"texturefile\s+(.+)", re.IGNORECASE)


def read_ply(path: Path, allow_outside: bool = False) -> tuple[np.ndarray, np.ndarray, SurfaceColors | None]:
    """Read a PLY file: vertices [V, 3] float32 or float64, faces [F, 3] int32 and surface colours, or None.

    Elements and properties of other names are skipped. Polygons are triangulated, and strips follow the faces. Texture
    coordinates without a picture are surface colours without ``has_colors``. ValueError: The file is damaged or has no
    faces; the message names the place.
    """
    points, corners, sizes, paint, names = _content(path)
    triangles = split_polygons(path, points, corners, sizes, not paint.is_plain)
    load, all_pictures = functools.cache(_image), PictureSum()
    images = [load(path, name, allow_outside, all_pictures) for name in names]
    return points, triangles.faces, paint.surface(path, triangles, sizes, images)


def _content(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, Paint, list[str]]:
    """Read vertices, corners of all polygons and their numbers, colours, and the names of pictures."""
    data = read_bytes(path)
    header = read_header(path, data)
    tables = read_tables(path, data, header)
    vertex, face, strips = (tables.get(name) for name in ("vertex", "face", "tristrips"))
    if vertex is None or not all(name in vertex for name in "xyz"):
        known = ", ".join(element.name for element in header.elements)
        raise ValueError(f"{path}: expected an element vertex with x, y and z, got {short(known or 'no element')}")
    points = checked_points(path, vertex.numbers("x", "y", "z"))
    corners, sizes = np.empty(0, np.int32), np.empty(0, np.int64)
    if face is not None and face.count:
        corners, sizes = face.lists(_corner_name(path, face))
    paint = Paint.read(path, vertex, face, sizes)
    if strips is not None:
        more = _strips(*strips.lists(_corner_name(path, strips)))
        corners = np.concatenate((corners, more.reshape(-1))) if len(corners) else more.reshape(-1)
        sizes = np.concatenate((sizes, np.full(len(more), 3)))
    names = [found[1].strip('" ') for comment in header.comments if (found := _IMAGE.match(comment))]
    return points, corners, sizes, paint, names


def _corner_name(path: Path, table: Table) -> str:
    name = next((name for name in _CORNERS if name in table), None)
    if name is None:
        raise ValueError(f"{path}: expected {_CORNERS[0]} in the element {table.name}, got none")
    return name


def _strips(values: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Convert strips of triangles to [F, 3]: −1 ends a strip, and each second triangle of a strip is flipped."""
    begins = np.zeros(len(values) + 1, bool)
    begins[np.cumsum(sizes) - sizes] = True
    begins = begins[:-1]
    ends = values == (np.iinfo(values.dtype).max if values.dtype.kind == "u" else -1)
    begins[1:] |= ends[:-1]
    place = np.arange(len(values))
    start = np.maximum.accumulate(np.where(begins, place, 0))
    last = place[2:]
    chosen = last[(last - start[last] >= 2) & ~(ends[last] | ends[last - 1] | ends[last - 2])]
    odd = ((chosen - start[chosen]) % 2).astype(bool)
    first, second = np.where(odd, chosen - 1, chosen - 2), np.where(odd, chosen - 2, chosen - 1)
    found: np.ndarray = values[np.stack((first, second, chosen), 1)]
    a, b, c = found.T
    return found[(a != b) & (b != c) & (c != a)]  # equal corners join strips


def _image(path: Path, name: str, allow_outside: bool, all_pictures: PictureSum) -> np.ndarray | None:
    """Load an image [H, W, 3] that the file names; warn if it is missing."""
    found = find_file(path, name, allow_outside=allow_outside)
    if found is None:
        warn(f"{path}: its file {short(name)} is missing")
        return None
    pixels = load_image(found).numpy()
    all_pictures.add(found, pixels.shape[0] * pixels.shape[1], found.stat().st_size)
    return np.ascontiguousarray(pixels[..., :3])


@dataclass(frozen=True)
class Paint:
    """Colours in a file: of V vertices, and of the P faces of the element face."""

    vertex_colors: np.ndarray | None  # [V, 3] float32
    face_colors: np.ndarray | None  # [P, 3] float32
    vertex_uv: np.ndarray | None  # [V, 2]
    corner_uv: np.ndarray | None  # [n, 2], of the corners that have any
    has_uv: np.ndarray | None  # [P], whether a face has texture coordinates at its corners
    vertex_number: np.ndarray | None  # [V], index of the picture
    face_number: np.ndarray | None  # [P]

    @classmethod
    def read(cls, path: Path, vertex: Table, face: Table | None, sizes: np.ndarray) -> Paint:
        """Read the columns of the elements; ``sizes`` [P] are the numbers of the faces' corners."""
        corner_uv = has_uv = None
        if face is not None and "texcoord" in face:
            corner_uv, has_uv = _corner_uv(path, face, sizes)
        names = next((names for names in _UV if all(name in vertex for name in names)), None)
        return cls(
            _colors(path, vertex),
            None if face is None else _colors(path, face),
            None if names is None else vertex.numbers(*names),
            corner_uv,
            has_uv,
            _picture_numbers(vertex),
            None if face is None else _picture_numbers(face),
        )

    @property
    def is_plain(self) -> bool:
        """Test whether no colour or coordinate belongs to faces or their corners."""
        return self.face_colors is None and self.has_uv is None and self.face_number is None

    def surface(
        self, path: Path, triangles: Triangles, sizes: np.ndarray, images: list[np.ndarray | None]
    ) -> SurfaceColors | None:
        """Collect the colours of triangles; a picture's number is its place in ``images``.

        ``sizes`` are the numbers of corners of all polygons; those that are not of the element face come last.
        """
        uv = self._uv(triangles, sizes)
        has_colors = self.vertex_colors is not None or self.face_colors is not None or bool(images)
        if uv is None and not has_colors:
            return None
        surface = SurfaceColors.plain(len(triangles.faces), 1.0)
        surface.has_colors = has_colors
        if self.vertex_colors is not None:
            surface.colors = self.vertex_colors[triangles.faces]
        elif self.face_colors is not None:
            colors = triangles.of_polygons(_padded(self.face_colors, len(sizes), 1.0))
            surface.colors = np.repeat(colors[:, None], 3, 1)
        if uv is None:
            if images:
                warn(f"{path}: its picture is not shown, because the file has no texture coordinates")
            return surface
        placed = fits_float32(uv).all(axis=(1, 2))
        surface.uv = np.where(np.expand_dims(placed, (1, 2)), uv, 0.0)
        numbers = self._numbers(triangles, len(sizes))
        for number, image in enumerate(images):
            chosen = np.flatnonzero(placed & (numbers == number))
            if image is not None and len(chosen):
                surface.paint(chosen, image, surface.uv[chosen])
        unknown = int((numbers >= len(images)).sum()) if images else 0
        if unknown:
            warn(f"{path}: {unknown} faces have a texnumber of at least {len(images)}, the number of its pictures")
        return surface

    def _uv(self, triangles: Triangles, sizes: np.ndarray) -> np.ndarray | None:
        """Return texture coordinates [F, 3, 2] float64, NaN for faces without; None without any."""
        if self.has_uv is not None:
            known = np.repeat(_padded(self.has_uv, len(sizes), False), sizes)
            uv = np.full((len(known), 2), np.nan)
            uv[known] = self.corner_uv
            return triangles.of_corners(uv)
        return None if self.vertex_uv is None else self.vertex_uv.astype(np.float64)[triangles.faces]

    def _numbers(self, triangles: Triangles, polygons: int) -> np.ndarray:
        """Return the number of the picture of each triangle, [F]; −1 for none."""
        if self.face_number is not None:
            return triangles.of_polygons(_padded(self.face_number, polygons, -1))
        if self.vertex_number is not None:
            return self.vertex_number[triangles.faces[:, 0]]
        return np.zeros(len(triangles.faces), np.int64)


def _padded(values: np.ndarray, count: int, other: float) -> np.ndarray:
    """Append ``other`` to values of the element face, for the triangles of strips."""
    pads = ((0, count - len(values)), *[(0, 0)] * (values.ndim - 1))
    return np.pad(values, pads, constant_values=other) if count > len(values) else values


def _colors(path: Path, table: Table) -> np.ndarray | None:
    names = next((names for names in _COLORS if all(name in table for name in names)), None)
    return None if names is None else unit_colors(path, table.numbers(*names), table.declared[names[0]])


def _picture_numbers(table: Table) -> np.ndarray | None:
    return np.nan_to_num(table.numbers("texnumber")[:, 0]).astype(np.int64) if "texnumber" in table else None


def _corner_uv(path: Path, face: Table, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Read texture coordinates by face: those of all corners that have any, [n, 2], and which faces have them, [P]."""
    values, counts = face.lists("texcoord")
    wrong = np.flatnonzero((counts != 2 * sizes) & (counts != 0))
    if len(wrong):
        first = int(wrong[0])
        expected = f"{2 * sizes[first]} numbers in the texcoord of face {first}"
        raise ValueError(f"{path}: expected {expected}, two for each corner, got {counts[first]}")
    return values.reshape(-1, 2), counts > 0
