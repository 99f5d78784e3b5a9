"""Build a GLB file with one buffer."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

MODES = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
"""Wrapping of textures."""
LINEAR = 9729
_COMPONENTS = {"<f4": 5126, "<u4": 5125, "<u2": 5123}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GlbFile:
    """Collects the entries of a file's lists by name, and the bytes that they refer to."""

    def __init__(self) -> None:
        self.lists: dict[str, list[Any]] = {
            name: [] for name in ("bufferViews", "accessors", "materials", "textures", "samplers", "images")
        }
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, name: str, entry: Any) -> int:
        """Append an entry to a list; return its number."""
        self.lists[name].append(entry)
        return len(self.lists[name]) - 1

    def view(self, data: bytes) -> int:
        """Append bytes; return the number of their view."""
        begin = self._size
        self._parts += data, bytes(-len(data) % 4)
        self._size += len(data) + len(self._parts[-1])
        return self.add("bufferViews", {"buffer": 0, "byteOffset": begin, "byteLength": len(data)})

    def accessor(self, values: np.ndarray, bounds: bool = False, **more: Any) -> int:
        """Append an array [n, width]; return the number of its accessor."""
        accessor: dict[str, Any] = {"bufferView": self.view(values.tobytes()), "count": len(values)}
        accessor |= {"componentType": _COMPONENTS[values.dtype.str], "type": _TYPES[values.shape[1]], **more}
        if bounds:
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        return self.add("accessors", accessor)

    def encoded(self, primitives: list[dict[str, Any]], **more: Any) -> bytes:
        """Encode the file, whose scene is a mesh of these primitives unless other entries of the JSON replace these."""
        tree: dict[str, Any] = {"asset": {"version": "2.0", "generator": "neural_renderer"}, "scene": 0}
        tree |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": primitives}], **more}
        tree |= {name: values for name, values in self.lists.items() if values}
        text = json.dumps(tree | {"buffers": [{"byteLength": self._size}]}, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + self._size, len(text), b"JSON")
        return b"".join((head, text, struct.pack("<I4s", self._size, b"BIN\0"), *self._parts))
