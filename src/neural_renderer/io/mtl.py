"""MTL material files: the diffuse colour and the diffuse image, which are all that a cube texture can hold."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .files import read_text, short

# No pattern may match the same text in two ways: then time grows with the square of a line's length.
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Options stand before the file name, which may itself hold spaces. -o, -s and -t take one to three numbers.
_OPTION = re.compile(
    rf"-(?P<name>o|s|t)(?P<numbers>(?:\s+{_NUMBER}(?=\s)){{1,3}})\s+"
    rf"|-mm\s+{_NUMBER}\s+{_NUMBER}\s+"
    r"|-(?P<word>blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s+(?P<value>\S+)\s+"
)
_TRAILING = re.compile(r"\s-(?:o|s|t|mm|blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s.*$")


@dataclass
class Material:
    """What one ``newmtl`` says: ``colour`` is Kd ([3] float in [0, 1], None if absent), ``image`` the name in map_Kd.

    Texture coordinates are to be taken as ``uv * scale + offset``; ``clamp`` asks not to repeat the image.
    """

    folder: Path
    colour: np.ndarray | None = None
    image: str | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False


def read_mtl(path: Path) -> dict[str, Material]:
    """The materials of an MTL file by name; ValueError names the file and line of a colour that cannot be read."""
    materials: dict[str, Material] = {}
    material = Material(path.parent)  # statements before the first newmtl belong to nobody
    for number, line in enumerate(read_text(path).split("\n"), 1):
        keyword, _, rest = line.strip().replace("\t", " ").partition(" ")
        keyword, rest = keyword.lower(), rest.strip()
        if keyword == "newmtl":
            material = materials[rest] = Material(path.parent)
        elif keyword == "kd" and not rest.startswith(("spectral", "xyz")):
            material.colour = _colour(rest, f"{path}, line {number}")
        elif keyword == "map_kd" and rest:
            _read_map(material, rest)
    return materials


def _colour(text: str, where: str) -> np.ndarray:
    words = text.partition("#")[0].split()[:3]
    try:
        colour = np.array([float(word) for word in words])
    except ValueError:
        colour = np.array([])
    if len(colour) not in (1, 3) or not np.isfinite(colour).all():
        raise ValueError(f"{where}: expected Kd and three finite numbers, got {short(text)}")
    return np.broadcast_to(colour.clip(0, 1), 3)


def _read_map(material: Material, text: str) -> None:
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
