"""Reading of MTL material files: colours, highlights, transparency and images."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..files import fits_float32, read_text, short

# A pattern must not match the same text in two ways, or time grows with the square of a line's length.
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Options precede the file name; the name may contain spaces. -o, -s and -t take one to three numbers.
_OPTION = re.compile(
    rf"-(?P<name>o|s|t)(?P<numbers>(?:\s+{_NUMBER}(?=\s)){{1,3}})\s+"
    rf"|-mm\s+{_NUMBER}\s+{_NUMBER}\s+"
    r"|-(?P<word>blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s+(?P<value>\S+)\s+"
)
_TRAILING = re.compile(r"\s-(?:o|s|t|mm|blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s.*$")


# Images of a material, by their statements; "bump" may hold heights or normals.
_MAPS = {
    "map_kd": "color",
    "map_ks": "specular",
    "map_ke": "emissive",
    "map_d": "opacity",
    "map_bump": "bump",
    "bump": "bump",
    "norm": "normal",
    "map_pm": "metallic",
    "map_pr": "roughness",
}
_COLORS = {"kd": "color", "ks": "specular", "ke": "emissive"}
_NUMBERS = {"ns": "shininess", "d": "opacity", "tr": "transparency", "pm": "metallic", "pr": "roughness"}


@dataclass
class Map:
    """Image of a material.

    Attributes:
        image: File name.
        scale: Factor of texture coordinates; the image is read at uv · scale + offset.
        offset: Offset of texture coordinates.
        clamp: Whether the image is clamped beyond [0, 1]; otherwise it repeats.
        bump: Factor of heights, or of the slopes of normals.
    """

    image: str
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False
    bump: float = 1.0


@dataclass
class Material:
    """Material of an MTL file.

    Attributes:
        folder: Folder of the file.
        colors: Kd, Ks and Ke by name, [3] float64 in [0, 1]; Ke may exceed 1.
        numbers: Ns, d (or 1 − Tr), Pm and Pr by name.
        maps: Images by name.
    """

    folder: Path
    colors: dict[str, np.ndarray] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    maps: dict[str, Map] = field(default_factory=dict)


def read_mtl(path: Path) -> dict[str, Material]:
    """Read the materials of an MTL file, by name. Raises ValueError, with file and line, for a wrong colour."""
    materials: dict[str, Material] = {}
    material = Material(path.parent)  # statements before the first newmtl are ignored
    for number, line in enumerate(read_text(path).split("\n"), 1):
        keyword, _, rest = line.strip().replace("\t", " ").partition(" ")
        keyword, rest = keyword.lower(), rest.strip()
        if keyword == "newmtl":
            material = materials[rest] = Material(path.parent)
        elif keyword in _COLORS and not rest.startswith(("spectral", "xyz")):
            color = _color(rest, 1 if keyword != "ke" else None)
            if color is not None:
                material.colors[_COLORS[keyword]] = color
            elif keyword == "kd":
                raise ValueError(f"{path}, line {number}: expected Kd and three finite numbers, got {short(rest)}")
        elif keyword in _NUMBERS:
            _read_number(material, _NUMBERS[keyword], rest)
        elif keyword in _MAPS and rest:
            material.maps[_MAPS[keyword]] = _map(rest)
    return materials


def _color(text: str, most: float | None) -> np.ndarray | None:
    """Parse the one or three numbers of a colour: [3] of at least 0; None if they are none."""
    words = text.partition("#")[0].split()[:3]
    try:
        color = np.array([float(word) for word in words])
    except ValueError:
        return None
    if len(color) not in (1, 3) or not np.isfinite(color).all() or not fits_float32(color.clip(0, most)).all():
        return None
    return np.broadcast_to(color.clip(0, most), 3)


def _read_number(material: Material, name: str, text: str) -> None:
    """Parse a number. Many exporters write others than the format allows, so what is none is ignored."""
    words = text.partition("#")[0].split()
    words = words[1:] if words[:1] == ["-halo"] else words
    try:
        value = float(words[0])
    except (ValueError, IndexError):
        return
    if not fits_float32(np.array(value)):
        return
    if name == "transparency":
        name, value = "opacity", 1 - value
    material.numbers[name] = max(0.0, value) if name == "shininess" else min(max(0.0, value), 1.0)


def _map(text: str) -> Map:
    """Parse the options and the file name of an image statement."""
    begin, result = 0, Map("")
    while option := _OPTION.match(text, begin):
        begin = option.end()
        numbers = [float(number) for number in (option["numbers"] or "").split()]
        if option["name"] == "s":
            result.scale = (numbers[0], numbers[1] if len(numbers) > 1 else 1.0)
        elif option["name"] == "o":
            result.offset = (numbers[0], numbers[1] if len(numbers) > 1 else 0.0)
        elif option["word"] == "clamp":
            result.clamp = option["value"] == "on"
        elif option["word"] == "bm" and re.fullmatch(_NUMBER, option["value"]):
            result.bump = float(option["value"])
    result.image = _TRAILING.sub("", text[begin:]).strip().strip('"')
    return result
