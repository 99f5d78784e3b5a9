"""Binary glTF of one mesh for the browser. `io.mesh_writer` writes files; this is faster and has the unlit material."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...io.surface_colors import srgb_to_linear

_FLOAT, _UINT, _USHORT = 5126, 5125, 5123  # component types of glTF
_VERTICES, _FACES = 34962, 34963  # targets of buffer views
_LINEAR = 9729
_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}


@dataclass(frozen=True, eq=False)
class Drawable:
    """Arrays that a graphics card draws."""

    vertices: np.ndarray  # [V, 3] float32
    corners: np.ndarray | None = None  # [N], the vertex at each drawn position; None if the vertices are drawn
    normals: np.ndarray | None = None  # [V, 3] float32, for smooth light; None for flat light
    index: np.ndarray | None = None  # [F, 3] uint32, faces of drawn positions; None if each three are a face
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)  # RGB of the whole mesh in [0, 1]
    colors: np.ndarray | None = None  # [N, 3] uint8 sRGB
    uv: np.ndarray | None = None  # [N, 2] float32, v down
    image: bytes | None = None  # a PNG or JPEG file
    wrap: str | tuple[str, str] = "repeat"  # wrapping beyond the border of the image, or a pair, for u and v
    lit: bool = True  # otherwise colours are shown unchanged

    @property
    def positions(self) -> np.ndarray:
        """The drawn positions, [N, 3]."""
        return self.vertices if self.corners is None else self.vertices[self.corners]

    @property
    def is_plain(self) -> bool:
        """Whether the mesh has one colour, and light."""
        return self.colors is None and self.image is None and self.lit

    @property
    def faces(self) -> np.ndarray:
        """The index [F, 3], also where the drawing needs none."""
        if self.index is not None:
            return self.index
        return np.arange(len(self.vertices if self.corners is None else self.corners), dtype=np.uint32).reshape(-1, 3)


def write_glb(parts: Sequence[Drawable]) -> bytes:
    """Make a GLB file of the parts of a mesh, each with at least one face."""
    body = _Body()
    primitives: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    textures: list[dict[str, int]] = []
    samplers: list[dict[str, int]] = []
    for part in parts:
        positions = part.positions.astype(np.float32)
        limits = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
        attributes = {"POSITION": body.array(positions, "VEC3", _FLOAT, _VERTICES, **limits)}
        if part.normals is not None and part.lit:
            normals = part.normals if part.corners is None else part.normals[part.corners]
            attributes["NORMAL"] = body.array(normals.astype(np.float32), "VEC3", _FLOAT, _VERTICES)
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
        if part.colors is not None:
            linear = np.full((len(positions), 4), 65535, np.uint16)
            linear[:, :3] = _LINEAR_OF_BYTE[part.colors]
            attributes["COLOR_0"] = body.array(linear, "VEC4", _USHORT, _VERTICES, normalized=True)
        elif part.image is not None and part.uv is not None:
            attributes["TEXCOORD_0"] = body.array(part.uv.astype(np.float32), "VEC2", _FLOAT, _VERTICES)
            mime = "image/png" if part.image.startswith(b"\x89PNG") else "image/jpeg"
            # Filters use no mipmaps, which would blend adjacent tiles of an atlas.
            across, down = (_WRAPS[part.wrap],) * 2 if isinstance(part.wrap, str) else (_WRAPS[w] for w in part.wrap)
            samplers.append({"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": across, "wrapT": down})
            textures.append({"source": len(images), "sampler": len(images)})
            surface["baseColorTexture"] = {"index": len(images)}
            images.append({"bufferView": body.view(part.image), "mimeType": mime})
        else:
            surface["baseColorFactor"] = [*srgb_to_linear(np.array(part.color)).tolist(), 1.0]
        primitive: dict[str, Any] = {"attributes": attributes, "material": len(materials)}
        if part.index is not None:
            primitive["indices"] = body.array(part.index.astype(np.uint32).reshape(-1), "SCALAR", _UINT, _FACES)
        primitives.append(primitive)
        unlit: dict[str, Any] = {} if part.lit else {"extensions": {"KHR_materials_unlit": {}}}
        materials.append({"pbrMetallicRoughness": surface, "doubleSided": True, **unlit})
    gltf: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "accessors": body.accessors,
        "bufferViews": body.views,
        "buffers": [{"byteLength": body.size}],
    }
    gltf |= {"textures": textures, "images": images, "samplers": samplers} if images else {}
    gltf |= {} if all(part.lit for part in parts) else {"extensionsUsed": ["KHR_materials_unlit"]}
    head = json.dumps(gltf).encode()
    head += b" " * (-len(head) % 4)
    total = 12 + 8 + len(head) + 8 + body.size
    chunks = b"glTF", _uint(2), _uint(total), _uint(len(head)), b"JSON", head, _uint(body.size), b"BIN\0"
    return b"".join((*chunks, *body.parts))


class _Body:
    """The binary part of a GLB file, with descriptions of its arrays."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []  # each padded to a multiple of four
        self.size = 0  # bytes in all
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, data: bytes, **more: Any) -> int:
        """Add bytes; return the number of their view."""
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(data), **more})
        padded = data + bytes(-len(data) % 4)
        self.parts.append(padded)
        self.size += len(padded)
        return len(self.views) - 1

    def array(self, values: np.ndarray, kind: str, component: int, target: int, **more: Any) -> int:
        """Add an array; return the number of its accessor."""
        view = self.view(np.ascontiguousarray(values).tobytes(), target=target)
        self.accessors.append(
            {"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more}
        )
        return len(self.accessors) - 1


def _uint(value: int) -> bytes:
    """Write a number in 32 bits."""
    return value.to_bytes(4, "little")


# glTF keeps linear colours of vertices and materials.
_LINEAR_OF_BYTE = (srgb_to_linear(np.arange(256) / 255) * 65535 + 0.5).astype(np.uint16)
