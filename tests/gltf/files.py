"""A small writer of glTF files for tests: arrays become accessors, everything else is JSON."""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

_CODES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # v down, the picture upright


class File:
    """A file while it is made."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.data = b""

    def add(self, name: str, entry: Any) -> int:
        """Append an entry to a list of the JSON; return its number."""
        self.json.setdefault(name, []).append(entry)
        return len(self.json[name]) - 1

    def view(self, data: bytes, **more: Any) -> int:
        """Append bytes; return the number of their view."""
        self.data += bytes(-len(self.data) % 4)
        begin = len(self.data)
        self.data += data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": begin, "byteLength": len(data), **more})

    def array(self, values: Any, dtype: Any = None, **more: Any) -> int:
        """Append an array [n] or [n, width]; return the number of its accessor."""
        values = np.asarray(values, dtype)
        values = values.reshape(len(values), -1)
        entry = {"count": len(values), "type": _TYPES[values.shape[1]], "componentType": _CODES[values.dtype.name]}
        step = -(-values.shape[1] * values.itemsize // 4) * 4
        rows = np.zeros((len(values), step), np.uint8)
        rows[:, : values.shape[1] * values.itemsize] = np.ascontiguousarray(values).view(np.uint8)
        stride = {"byteStride": step} if step != values.shape[1] * values.itemsize and len(values) > 1 else {}
        data = values.tobytes() if values.shape[1] == 1 else rows.tobytes()
        stride = {} if values.shape[1] == 1 else stride
        return self.add("accessors", {"bufferView": self.view(data, **stride), **entry, **more})

    def picture(self, pixels: Any, kind: str = "PNG", **options: Any) -> int:
        """Append an image of bytes [H, W, 3 or 4]; return its number."""
        file = io.BytesIO()
        Image.fromarray(np.asarray(pixels, np.uint8)).save(file, kind, **options)
        return self.add("images", {"bufferView": self.view(file.getvalue()), "mimeType": f"image/{kind.lower()}"})

    def texture(self, pixels: Any, **sampler: Any) -> int:
        """Append a texture of bytes [H, W, 3 or 4]; return its number."""
        entry = {"source": self.picture(pixels)}
        if sampler:
            entry["sampler"] = self.add("samplers", sampler)
        return self.add("textures", entry)

    def square(self, material: Any = None, **attributes: int) -> dict[str, Any]:
        """Make a primitive of the square from −1 to 1, that shows its front to +z."""
        primitive: dict[str, Any] = {
            "attributes": {"POSITION": self.array(SQUARE), **attributes},
            "indices": self.array(FACES),
        }
        if material is not None:
            primitive["material"] = self.add("materials", material)
        return primitive

    def scene(self, *primitives: dict[str, Any], **node: Any) -> File:
        """Make a scene of one node with these primitives."""
        mesh = self.add("meshes", {"primitives": list(primitives)})
        self.add("scenes", {"nodes": [self.add("nodes", {"mesh": mesh, **node})]})
        return self

    def save(self, path: Path) -> Path:
        """Write the file: .glb, or .gltf with its data in the JSON."""
        tree = dict(self.json)
        if self.data:
            tree["buffers"] = [{"byteLength": len(self.data)}]
        if path.suffix == ".gltf":
            if self.data:
                tree["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(self.data).decode()
            path.write_text(json.dumps(tree))
            return path
        text = json.dumps(tree).encode()
        chunks = [(b"JSON", text + b" " * (-len(text) % 4))]
        if self.data:
            chunks.append((b"BIN\0", self.data + bytes(-len(self.data) % 4)))
        body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
        return path


def textured(file: File, pixels: Any, **info: Any) -> dict[str, Any]:
    """Make a material with a texture of its base colour."""
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(pixels), **info}}}
