"""OFF files, with colours of vertices and faces.

Source: Geomview's manual, OFF Files. Programs also write colours of vertices as whole numbers up to 255.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .files import read_text, short, warn
from .polygon_meshes import checked_points, parsed_numbers, split_polygons, unit_colors
from .surface_colors import SurfaceColors

_KEYWORD = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF")
_MOST = 10**9  # vertices, or faces


def read_off(path: Path) -> tuple[np.ndarray, np.ndarray, SurfaceColors | None]:
    """Read an OFF file: vertices [V, 3] float64, faces [F, 3] int32 and surface colours, or None.

    ValueError: The file is damaged, binary or of more than three dimensions, or it has no faces.
    """
    lines = [stripped for line in read_text(path).split("\n") if (stripped := line.partition("#")[0].strip())]
    found = _KEYWORD.match(lines[0]) if lines else None
    if found is not None and (found[4] or found[5] or lines[0][found.end() :].strip().upper() == "BINARY"):
        raise ValueError(f"{path}: expected an OFF file of three dimensions as text, got {short(lines[0])}")
    if found is not None:
        rest = lines[0][found.end() :].strip()
        lines = [*([rest] if rest else []), *lines[1:]]  # the counts may follow in the same line
    words = lines[0].split() if lines else []
    if len(words) < 2 or not all(word.isascii() and word.isdigit() and int(word) < _MOST for word in words[:3]):
        got = short(lines[0]) if lines else "nothing"
        raise ValueError(f"{path}: expected OFF and the numbers of vertices and faces, got {got}")
    vertices, faces = int(words[0]), int(words[1])
    if found is None or not (found[1] or found[2]):
        lines = _one_line_each(lines, vertices, faces, 6 if found is not None and found[3] else 3)
    if len(lines) < 1 + vertices + faces:
        got = f"{len(lines) - 1} lines; the file is cut"
        raise ValueError(f"{path}: expected {vertices} vertices and {faces} faces, each in a line, got {got}")
    rows = [line.split() for line in lines[1 : 1 + vertices]]
    points = checked_points(path, parsed_numbers(path, rows, 3, "vertex"))
    corners, sizes, rests = _polygons(path, lines[1 + vertices : 1 + vertices + faces])
    triangles = split_polygons(path, points, corners, sizes)
    surface = SurfaceColors.plain(len(triangles.faces), 1.0)
    surface.has_colors = False
    if found is not None and found[2]:
        begin = 6 if found[3] else 3  # after the normal
        own_words = [row[begin : begin + 3] for row in rows]
        colors = _colors(path, own_words, "the colour of vertex", 1)
        surface.colors, surface.has_colors = colors[triangles.faces], True
    elif rows and not (found and (found[1] or found[3])) and all(len(row) > 5 for row in rows):
        warn(f"{path}: its vertices have {len(rows[0])} numbers each, but without COFF only the first three are read")
    colored = np.flatnonzero([len(rest) > 2 for rest in rests])
    if len(colored):
        face_colors = np.full((len(sizes), 3), np.nan, np.float32)
        face_colors[colored] = _colors(path, [rests[number][:3] for number in colored], "the colour of face", 0)
        face_colors = triangles.of_polygons(face_colors)
        known = ~np.isnan(face_colors[:, 0])
        surface.colors[known], surface.has_colors = face_colors[known][:, None], True
    mapped = sum(len(rest) == 1 for rest in rests)
    if mapped:
        warn(f"{path}: {mapped} faces have a place in a colour map as their colour, which is not read")
    return points, triangles.faces, surface if surface.has_colors else None


def _one_line_each(lines: list[str], vertices: int, faces: int, width: int) -> list[str]:
    """Put each vertex, of ``width`` numbers, and each face into a line, if lines are broken at other places.

    Lines that cannot be so, or that are so already, stay as they are.
    """
    if len(lines) == 1 + vertices + faces:
        return lines
    words = " ".join(lines[1:]).split()
    result, at = [lines[0]], vertices * width
    result += [" ".join(words[begin : begin + width]) for begin in range(0, at, width)]
    for _ in range(faces):
        size = words[at] if at < len(words) else ""
        if not (size.isascii() and size.isdigit() and len(size) < 10):
            return lines
        result.append(" ".join(words[at : at + 1 + int(size)]))
        at += 1 + int(size)
    return result if at == len(words) else lines


def _polygons(path: Path, lines: list[str]) -> tuple[np.ndarray, np.ndarray, list[list[str]]]:
    """Return the corners of all faces in a row, the number of each, and the words after them."""
    sizes, rests = np.empty(len(lines), np.int64), []
    corners: list[str] = []
    for number, line in enumerate(lines):
        words = line.split()
        size = int(words[0]) if words[0].isascii() and words[0].isdigit() and len(words[0]) < 10 else -1
        if not 0 <= size < len(words):
            raise ValueError(f"{path}: expected a count and as many vertices in face {number}, got {short(line)}")
        sizes[number] = size
        corners += words[1 : 1 + size]
        rests.append(words[1 + size :])
    return parsed_numbers(path, [[word] for word in corners], 1, "corner")[:, 0], sizes, rests


def _colors(path: Path, words: list[list[str]], what: str, whole_end: int) -> np.ndarray:
    """Convert words to colours in [0, 1], [rows, 3] float32: whole numbers up to 255, others up to 1.

    Whole numbers that are all at most ``whole_end`` are those up to 1.
    """
    values = parsed_numbers(path, words, 3, what)
    whole = all(word.lstrip("+").isdigit() for row in words for word in row) and values.max(initial=0) > whole_end
    return unit_colors(path, values, "i4" if whole else "f8")
