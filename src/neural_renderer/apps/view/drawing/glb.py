"""Binary glTF of one mesh for the browser. `io.mesh_writer` writes files; this is faster and has the unlit material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....io.gltf.glb_file import LINEAR, MODES, GlbFile
from ....io.surface_colors import srgb_to_linear


@dataclass(frozen=True, eq=False)
class Drawable:
    """Arrays that a graphics card draws."""

    vertices: np.ndarray  # [V, 3] float32
    corners: np.ndarray | None = None  # [N], the vertex at each drawn position; None if the vertices are drawn
    normals: np.ndarray | None = None  # [V, 3] float32, for smooth light; None for flat light
    index: np.ndarray | None = None  # [F, 3] uint32, faces of drawn positions; None if each three are a face
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)  # RGB of the whole mesh in [0, 1]
    colors: np.ndarray | None = None  # [N, 3] uint8 sRGB, factors of the image in linear light
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
    file = GlbFile()
    primitives: list[dict[str, Any]] = []
    for part in parts:
        positions = part.positions.astype(np.float32)
        attributes = {"POSITION": file.accessor(positions, bounds=True)}
        if part.normals is not None and part.lit:
            normals = part.normals if part.corners is None else part.normals[part.corners]
            attributes["NORMAL"] = file.accessor(normals.astype(np.float32))
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
        if part.colors is not None:  # which multiply an image
            linear = np.full((len(positions), 4), 65535, np.uint16)
            linear[:, :3] = _LINEAR_OF_BYTE[part.colors]
            attributes["COLOR_0"] = file.accessor(linear, normalized=True)
        if part.image is not None and part.uv is not None:
            attributes["TEXCOORD_0"] = file.accessor(part.uv.astype(np.float32))
            mime = "image/png" if part.image.startswith(b"\x89PNG") else "image/jpeg"
            # Filters use no mipmaps, which would blend adjacent tiles of an atlas.
            across, down = (MODES[w] for w in ((part.wrap,) * 2 if isinstance(part.wrap, str) else part.wrap))
            options = {"magFilter": LINEAR, "minFilter": LINEAR, "wrapS": across, "wrapT": down}
            image = file.add("images", {"bufferView": file.view(part.image), "mimeType": mime})
            texture = {"source": image, "sampler": file.add("samplers", options)}
            surface["baseColorTexture"] = {"index": file.add("textures", texture)}
        elif part.colors is None:
            surface["baseColorFactor"] = [*srgb_to_linear(np.array(part.color)).tolist(), 1.0]
        unlit: dict[str, Any] = {} if part.lit else {"extensions": {"KHR_materials_unlit": {}}}
        material = file.add("materials", {"pbrMetallicRoughness": surface, "doubleSided": True, **unlit})
        primitive: dict[str, Any] = {"attributes": attributes, "material": material}
        if part.index is not None:
            primitive["indices"] = file.accessor(part.index.astype(np.uint32).reshape(-1, 1))
        primitives.append(primitive)
    more = {} if all(part.lit for part in parts) else {"extensionsUsed": ["KHR_materials_unlit"]}
    return file.encoded(primitives, **more)


# glTF keeps linear colours of vertices and materials.
_LINEAR_OF_BYTE = (srgb_to_linear(np.arange(256) / 255) * 65535 + 0.5).astype(np.uint16)
