"""Reading of MTL material files: diffuse colours and diffuse images."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import read_text, short

# A pattern must not match the same text in two ways, or time grows with the square of a line's length.
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Options precede the file name; the name may contain spaces. -o, -s and -t take one to three numbers.
_OPTION = re.compile(
    rf"-(?P<name>o|s|t)(?P<numbers>(?:\s+{_NUMBER}(?=\s)){{1,3}})\s+"
    rf"|-mm\s+{_NUMBER}\s+{_NUMBER}\s+"
    r"|-(?P<word>blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s+(?P<value>\S+)\s+"
)
_TRAILING = re.compile(r"\s-(?:o|s|t|mm|blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s.*$")


@dataclass
class Material:
    """Material of an MTL file.

    Attributes:
        folder: Folder of the file.
        color: Kd, [3] float64 in [0, 1], or None.
        image: File name in map_Kd, or None.
        scale: Factor of texture coordinates; the image is read at uv · scale + offset.
        offset: Offset of texture coordinates.
        clamp: Whether the image is clamped beyond [0, 1]; otherwise it repeats.
    """

    folder: Path
    color: np.ndarray | None = None
    image: str | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False


def read_mtl(path: Path) -> dict[str, Material]:
    """Read the materials of an MTL file, by name. Raises ValueError, with file and line, for a wrong colour."""
    materials: dict[str, Material] = {}
    material = Material(path.parent)  # statements before the first newmtl are ignored
    for number, line in enumerate(read_text(path).split("\n"), 1):
        keyword, _, rest = line.strip().replace("\t", " ").partition(" ")
        keyword, rest = keyword.lower(), rest.strip()
        if keyword == "newmtl":
            material = materials[rest] = Material(path.parent)
        elif keyword == "kd" and not rest.startswith(("spectral", "xyz")):
            material.color = _color(rest, f"{path}, line {number}")
        elif keyword == "map_kd" and rest:
            _read_map(material, rest)
    return materials


def _color(text: str, where: str) -> np.ndarray:
    """Parse the one or three numbers of a Kd statement: [3] in [0, 1]."""
    words = text.partition("#")[0].split()[:3]
    try:
        color = np.array([float(word) for word in words])
    except ValueError:
        color = np.array([])
    if len(color) not in (1, 3) or not np.isfinite(color).all():
        raise ValueError(f"{where}: expected Kd and three finite numbers, got {short(text)}")
    return np.broadcast_to(color.clip(0, 1), 3)


def _read_map(material: Material, text: str) -> None:
    """Parse the options and the file name of a map_Kd statement into ``material``."""
    begin = 0
    while option := _OPTION.match(text, begin):
        begin = option.end()
        numbers = [float(number) for number in (option["numbers"] or "").split()]
        if option["name"] == "s":
            material.scale = (numbers[0], numbers[1] if len(numbers) > 1 else 1.0)
        elif option["name"] == "o":
            material.offset = (numbers[0], numbers[1] if len(numbers) > 1 else 0.0)
        elif option["word"] == "clamp":
            material.clamp = option["value"] == "on"
    material.image = _TRAILING.sub("", text[begin:]).strip().strip('"')
