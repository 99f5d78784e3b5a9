"""The header of a PLY file: its elements, their properties, and its comments.

Source: Greg Turk, The PLY Polygon File Format, 1994.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from ..files import short, warn

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
"""NumPy's name of each type of the format, and of the other names that programs write."""

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_FIRST = re.compile(rb"ply[ \t]*(\r\n|\n|\r)")
_END = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(\r\n|\n|\r|$)")
_MOST = 2**40  # rows of an element
_LONGEST = 4096  # bytes that are read of a header without an end, for its error message


@dataclass(frozen=True)
class Property:
    """A property of an element: a number, or a list of numbers after their count."""

    name: str
    type: str  # a value of `TYPES`
    count: str | None = None  # type of the count; None for a number


@dataclass(frozen=True)
class Element:
    """A table: ``count`` rows, each with a value of every property, in order."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


@dataclass(frozen=True)
class Header:
    """The header of a file."""

    order: str  # of the bytes of numbers, "<" or ">"; "" for text
    elements: list[Element]
    comments: list[str]
    length: int  # bytes of the header


def read_header(path: Path, data: bytes) -> Header:
    """Parse the header of a file with the content ``data``; raise ValueError with the line if it is malformed."""
    first, end = _FIRST.match(data), _END.search(data)
    if first is None:
        line = short(_text(data[:20].partition(b"\n")[0]))
        raise ValueError(f'{path}: expected the first line "ply", got {line}')
    order: str | None = None
    elements: list[Element] = []
    comments: list[str] = []
    lines = re.split(r"\r\n|\n|\r", _text(data[first.end() : _LONGEST if end is None else end.start()]))
    for number, line in enumerate(lines, 2):
        keyword, *words = line.split() or [""]
        where = f"{path}, line {number}"
        if keyword == "format":
            order = _ORDERS.get(words[0] if words else "")
            if order is None:
                raise ValueError(f"{where}: expected a format out of {', '.join(_ORDERS)}, got {short(line.strip())}")
        elif keyword == "element":
            elements.append(_element(where, words))
        elif keyword == "property":
            if not elements:
                raise ValueError(f"{where}: expected an element before its properties, got none")
            elements[-1].properties.append(_property(where, words))
        elif keyword == "comment":
            comments.append(line.strip()[len("comment") :].strip())
        elif keyword not in ("", "obj_info") and elements:
            raise ValueError(f"{where}: expected element, property or comment, got {short(line.strip())}")
        elif keyword not in ("", "obj_info"):
            warn(f"{where}: {short(line.strip())} is no line of a PLY header; it is left out")
    if end is None:
        raise ValueError(f'{path}: expected a header that ends with "end_header", got none; the file is cut')
    if order is None:
        raise ValueError(f"{path}: expected a line with the format in the header, got none")
    # Where lines end with a single \r, a \n after the last one is the first byte of the numbers.
    return Header(order, elements, comments, end.start(1) + 1 if first[1] == b"\r" else end.end())


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _element(where: str, words: list[str]) -> Element:
    if len(words) != 2 or not words[1].isascii() or not words[1].isdigit() or len(words[1]) > len(str(_MOST)):
        raise ValueError(f"{where}: expected a name and a number of rows after element, got {short(' '.join(words))}")
    return Element(words[0], int(words[1]))


def _property(where: str, words: list[str]) -> Property:
    kinds = words[1:3] if words[:1] == ["list"] else words[:1]
    if len(words) != (4 if len(kinds) == 2 else 2) or not all(kind in TYPES for kind in kinds):
        got = short(" ".join(words))
        raise ValueError(f"{where}: expected a type, or list and two types, and a name after property, got {got}")
    if len(kinds) == 2:
        return Property(words[3], TYPES[kinds[1]], TYPES[kinds[0]])
    return Property(words[1], TYPES[kinds[0]])
