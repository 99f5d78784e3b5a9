"""The containers of glTF 2.0: a file of JSON, or a binary file of chunks (section 4.4 of the specification)."""

from __future__ import annotations

import json
from typing import Any

from ..files import short
from .tree import GltfError, as_object, child

MAGIC = b"glTF"
HEADER, CHUNK = 12, 8
"""Bytes of the header of the file, and of that of a chunk."""
_JSON, _BINARY = b"JSON", b"BIN\0"


def parsed(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """Return the JSON of a file and its binary chunk or None. The content decides the form, not the suffix."""
    if len(data) < len(MAGIC):
        raise GltfError("it is cut")
    text, binary = _chunks(data) if data[:4] == MAGIC else (data, None)
    tree = as_object(_json(text), "its JSON")
    version = str(child(tree, "asset").get("version", "2.0"))
    least = str(child(tree, "asset").get("minVersion", "2.0"))
    if version.partition(".")[0] != "2" or least != "2.0":
        raise GltfError(f"expected glTF 2.0, got version {short(least if version.startswith('2') else version)}")
    return tree, binary


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """Find the chunk of JSON in a binary file, and the binary one; others are left out."""
    if len(data) < HEADER:
        raise GltfError("it is cut")
    version = int.from_bytes(data[4:8], "little")
    if version != 2:
        raise GltfError(f"expected glTF 2.0, got version {version}")
    found: list[tuple[bytes, bytes]] = []
    place = HEADER
    while place + CHUNK <= len(data):
        length, kind = int.from_bytes(data[place : place + 4], "little"), data[place + 4 : place + CHUNK]
        place += CHUNK
        if place + length > len(data):
            raise GltfError(f"expected chunks within its {len(data)} bytes, got one of {length} bytes")
        found.append((kind, data[place : place + length]))
        place += length
    text = next((content for kind, content in found if kind == _JSON), None)
    if text is None:
        raise GltfError("it has no chunk of JSON" if found else "it is cut")
    return text, next((content for kind, content in found if kind == _BINARY), None)


def _json(text: bytes) -> Any:
    try:
        return json.loads(text.rstrip(b"\0").decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise GltfError("its text is not UTF-8") from None
    except json.JSONDecodeError as error:
        if text.startswith(b"version https://git-lfs"):
            raise GltfError("it is a pointer of Git LFS; `git lfs pull` gets the file") from None
        raise GltfError(f"its JSON is damaged in line {error.lineno}, column {error.colno}") from None
    except (RecursionError, ValueError):
        raise GltfError("its JSON is nested too deeply, or has a number of too many digits") from None
