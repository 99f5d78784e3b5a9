"""An independent reader of PLY, STL and OFF files, slow and by the formats' texts.

``python -m tests.io.polygon_reader FOLDER …`` compares all files of folders with `load_mesh`, and prints a line for
each.

It shares no code with the package, and reads numbers one by one.
"""

from __future__ import annotations

import re
import struct
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

import neural_renderer as nr

CODES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
    "int64": "q", "uint64": "Q",
}  # fmt: skip
SUFFIXES = (".ply", ".stl", ".off")
COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))


@dataclass
class Polygons:
    """What a file holds."""

    points: list[list[float]]
    polygons: list[list[int]] = field(default_factory=list)
    vertex_colors: list[list[float]] | None = None
    face_colors: list[list[float]] | None = None


class Refused(Exception):
    """The file is not valid, or has no faces."""


def read(path: Path) -> Polygons:
    """Read a file of any of the formats."""
    data = path.read_bytes()
    try:
        found = {".ply": read_ply, ".stl": read_stl, ".off": read_off}[path.suffix.lower()](data)
    except (ValueError, IndexError, KeyError, struct.error, StopIteration, RuntimeError) as error:
        raise Refused(repr(error)) from error
    found.polygons = [polygon for polygon in found.polygons if len(polygon) > 2]
    if not found.polygons or any(not 0 <= corner < len(found.points) for each in found.polygons for corner in each):
        raise Refused("no faces, or wrong ones")
    return found


def read_ply(data: bytes) -> Polygons:
    """Read a PLY file, one number after the other."""
    lines, at = [], 0
    while True:
        end = min(place for place in (data.find(b"\n", at), data.find(b"\r", at)) if place >= 0)
        line, at = data[at:end].decode("latin-1").split(), end + 1
        if data[end : end + 2] == b"\r\n":
            at += 1
        lines.append(line)
        if line == ["end_header"]:
            break
    if lines[0] != ["ply"]:
        raise ValueError("no PLY")
    kind, elements = "", []
    for line in lines:
        if line[:1] == ["format"]:
            kind = line[1]
        elif line[:1] == ["element"]:
            elements.append((line[1], int(line[2]), []))
        elif line[:1] == ["property"]:
            elements[-1][2].append(line[1:])
    words, rows_of_text = iter(data[at:].split()), [row for row in data[at:].splitlines() if row.split()]
    text = iter(rows_of_text)
    in_lines = len(rows_of_text) >= sum(count for _, count, _ in elements)  # which may be longer than their properties
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]

    def number(name: str) -> Any:
        nonlocal at, words
        if not order:
            return float(next(words))
        code = order + CODES[name]
        at += struct.calcsize(code)
        return struct.unpack_from(code, data, at - struct.calcsize(code))[0]

    tables: dict[str, list[dict[str, Any]]] = {}
    kinds: dict[tuple[str, str], str] = {}
    for name, count, properties in elements:
        rows = tables.setdefault(name, [])
        for part in properties:
            kinds.setdefault((name, part[-1]), part[-2])
        for _ in range(count):
            row: dict[str, Any] = {}
            if in_lines and not order:
                words = iter(next(text).split())
            for part in properties:
                value: Any = number(part[1 if part[0] == "list" else 0])
                if part[0] == "list":
                    value = [number(part[2]) for _ in range(int(value))]
                row.setdefault(part[-1], value)
            rows.append(row)

    def corners(row: dict[str, Any]) -> list[int]:
        return [int(corner) for corner in row.get("vertex_indices", row.get("vertex_index"))]

    def colors(name: str) -> list[list[float]] | None:
        rows = tables.get(name, [])
        for names in COLORS:
            if rows and all(each in rows[0] for each in names):
                values = [[row[each] for each in names] for row in rows]
                most = max(max(row) for row in values)  # the format gives floats no range
                top = {"B": 255.0, "H": 65535.0}.get(CODES[kinds[name, names[0]]], 255.0 if most > 1 else 1.0)
                return [[value / top for value in row] for row in values]
        return None

    polygons = [corners(row) for row in tables.get("face", [])]
    for row in tables.get("tristrips", []):
        polygons += list(triangles_of_strip(corners(row)))
    points = [[float(row[axis]) for axis in "xyz"] for row in tables["vertex"]]
    return Polygons(points, polygons, colors("vertex"), colors("face"))


def triangles_of_strip(corners: list[int]) -> Iterator[list[int]]:
    """Iterate over the triangles of a strip; −1 ends a part of it."""
    part: list[int] = []
    for corner in corners:
        part = [] if corner == -1 else [*part, corner]
        if len(part) > 2:
            a, b, c = part[-3:]
            if len({a, b, c}) == 3:
                yield [b, a, c] if len(part) % 2 == 0 else [a, b, c]


def read_stl(data: bytes) -> Polygons:
    """Read an STL file; each face has its own vertices."""
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 1 << 40
    if 84 + 50 * count <= len(data):
        points = [list(struct.unpack_from("<3f", data, 96 + 50 * i + 12 * k)) for i in range(count) for k in range(3)]
    else:
        lines = [line.split() for line in data.decode("latin-1").lower().replace("\r", "\n").split("\n")]
        if lines[0][0] != "solid":
            raise ValueError("no STL")
        points = [[float(word) for word in line[1:4]] for line in lines if line[:1] == ["vertex"]]
    return Polygons(points, [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(len(points) // 3)])


def read_off(data: bytes) -> Polygons:
    """Read an OFF file."""
    text = data.decode("latin-1").replace("\r", "\n")
    lines = [line for line in (line.split("#")[0].strip() for line in text.split("\n")) if line]
    found = re.match("[A-Z]*?OFF", lines[0])
    kind = found[0] if found else ""
    lines[0] = lines[0][len(kind) :]
    rows = [line.split() for line in lines if line]
    vertices, faces = int(rows[0][0]), int(rows[0][1])
    if kind == "OFF" and len(rows) != 1 + vertices + faces:  # free format
        words = iter([word for row in rows[1:] for word in row])
        free = [[next(words) for _ in range(3)] for _ in range(vertices)]
        for _ in range(faces):
            size = next(words)
            free.append([size, *(next(words) for _ in range(int(size)))])
        rows = rows if list(words) else [rows[0], *free]
    rows, others = rows[1 : 1 + vertices], rows[1 + vertices : 1 + vertices + faces]
    if len(others) < faces:
        raise ValueError("cut")
    polygons = [[int(word) for word in row[1 : 1 + int(row[0])]] for row in others]
    if any(len(polygon) != int(row[0]) for polygon, row in zip(polygons, others, strict=True)):
        raise ValueError("cut")
    begin = 6 if "N" in kind.removesuffix("OFF") else 3
    result = Polygons([[float(word) for word in row[:3]] for row in rows], polygons)
    if "C" in kind.removesuffix("OFF"):
        result.vertex_colors = unit([row[begin : begin + 3] for row in rows])
    tails = [row[1 + int(row[0]) :][:3] for row in others]
    if all(len(tail) == 3 for tail in tails):
        result.face_colors = unit(tails)
    return result


def unit(rows: list[list[str]]) -> list[list[float]]:
    """Convert whole numbers up to 255, or others up to 1."""
    top = 1.0 if any("." in word for row in rows for word in row) else 255.0
    return [[float(word) / top for word in row] for row in rows]


def difference(path: Path) -> str:
    """Compare `load_mesh` with this reader: "right", "refused: …" or "wrong: …"."""
    try:
        expected: Polygons | None = read(path)
    except Refused:
        expected = None
    try:
        vertices, faces, textures = nr.load_mesh(path, 1)
    except ValueError as error:
        message = str(error).replace(str(path), path.name)
        return f"refused: {message}" if expected is None else f"wrong: refused a valid file: {message}"
    if expected is None:
        return "wrong: read a file that is not valid"
    points = np.array(expected.points, np.float32)
    if path.suffix.lower() != ".stl" and not np.array_equal(vertices.numpy(), points):
        return "wrong: vertices"
    corners = vertices.double().numpy()[faces.numpy()]
    turns = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    begin, size = 0, np.abs(points).max() ** 2 + 1e-30
    for number, polygon in enumerate(expected.polygons):
        own = slice(begin, begin + len(polygon) - 2)
        begin = own.stop
        outline = points[polygon].astype(np.float64)
        spokes = outline[1:] - outline[0]
        turn = np.cross(spokes[:-1], spokes[1:]).sum(0)
        used = {tuple(corner) for corner in corners[own].reshape(-1, 3).tolist()}
        if (
            used != {tuple(corner) for corner in outline.tolist()}
            or np.abs(turns[own].sum(0) - turn).max() > 1e-9 * size
        ):
            return f"wrong: polygon {number}"
        color = None if textures is None else textures[own].mean((0, 1, 2, 3)).numpy()
        wanted = expected.face_colors and expected.face_colors[number]
        if expected.vertex_colors is not None:
            own_corners = faces.numpy()[own]
            wanted = list(np.mean([expected.vertex_colors[corner] for corner in own_corners.reshape(-1)], 0))
        if wanted is not None and (color is None or np.abs(color - wanted).max() > 1e-5):
            return f"wrong: colour of polygon {number}: {color}, expected {wanted}"
    return "right" if begin == len(faces) else f"wrong: {len(faces)} faces, expected {begin}"


def main(folders: list[str]) -> None:
    """Print a line for each file of the folders, and how many there are of each kind."""
    counts: dict[str, int] = {}
    torch.set_num_threads(1)
    for folder in folders:
        for path in sorted(Path(folder).rglob("*")):
            if path.suffix.lower() in SUFFIXES and path.is_file():
                with warnings.catch_warnings(record=True) as told:
                    warnings.simplefilter("always")
                    found = difference(path)
                sentences = "; ".join(str(warning.message).replace(str(path), path.name) for warning in told)
                counts[found.partition(":")[0]] = counts.get(found.partition(":")[0], 0) + 1
                sys.stdout.write(f"{path}: {found}{' — ' if sentences else ''}{sentences}\n")
    sys.stdout.write(f"{counts}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
