"""The JSON of a glTF or GLB file: read, and changed so that trimesh keeps what materials need.

trimesh reads the geometry and the images. It keeps the name of a material and vertex attributes whose names start with
an underscore. So materials are named by their numbers, and normals, tangents and the second texture coordinates are
given a second name.
"""

from __future__ import annotations

import json
import struct
from typing import Any

# Attributes of vertices, and the names under which trimesh keeps them.
KEPT = {"NORMAL": "_NR_NORMAL", "TANGENT": "_NR_TANGENT", "TEXCOORD_0": "_NR_UV0", "TEXCOORD_1": "_NR_UV1"}

_JSON = 0x4E4F534A
_HEADER, _CHUNK = 12, 8  # bytes


def prepared(data: bytes, is_binary: bool) -> tuple[bytes, dict[str, Any]]:
    """Change the content of a file as the module says; return it and the JSON as it was.

    Raises:
        Errors of many classes if the file is damaged.
    """
    text, rest = data, b""
    if is_binary:
        length, kind = struct.unpack_from("<II", data, _HEADER)
        if kind != _JSON:
            raise ValueError("its first chunk is not JSON")
        begin = _HEADER + _CHUNK
        text, rest = data[begin : begin + length], data[begin + length :]
    tree = json.loads(text)
    original = json.loads(text)
    if not isinstance(tree, dict):
        raise ValueError("its JSON is not an object")
    for number, material in enumerate(_dicts(tree, "materials")):
        material["name"] = str(number)
    for mesh in _dicts(tree, "meshes"):
        for primitive in _dicts(mesh, "primitives"):
            attributes = primitive.get("attributes")
            if isinstance(attributes, dict):
                attributes |= {KEPT[name]: attributes[name] for name in KEPT if name in attributes}
    changed = json.dumps(tree).encode()
    if not is_binary:
        return changed, original
    changed += b" " * (-len(changed) % 4)
    length = _HEADER + _CHUNK + len(changed) + len(rest)
    return data[:8] + struct.pack("<III", length, len(changed), _JSON) + changed + rest, original


def _dicts(tree: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the objects of a list in a JSON object; empty if it is none."""
    values = tree.get(name)
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []
