"""Writing of GLB files with the materials of a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from ..image_formats.png import encode_png
from ..obj.writer import as_bytes
from ..surface_colors import FileTexture, SurfaceColors, srgb_to_linear
from .glb_file import LINEAR, MODES, GlbFile
from .primitives import DISPLAY, NUMBER
from .rig_reader import RigFile
from .rig_writer import rig_entries

_MOST_NUMBERED = 1 << 24  # vertices that float32, the only type for large attributes in glTF, can number
_LEVELS = "MSFT_lod"
_MATT: dict[str, Any] = {"metallic": 0.0, "roughness": 1.0, "double_sided": True}
_TEXTURES = {
    "emissive_texture": "emissiveTexture",
    "occlusion_texture": "occlusionTexture",
    "normal_texture": "normalTexture",
}


def glb_bytes(points: np.ndarray, corners: np.ndarray, surface: SurfaceColors, rig: RigFile | None = None) -> bytes:
    """Encode a mesh of vertices [V, 3] and faces [F, 3] as GLB: a primitive for each base colour's image and material.

    Colours beyond [0, 1] are clamped. A rig adds joints, a skin, morph targets and animations.
    """
    writer = _Writer(surface, rig, GlbFile())
    writer.add_all(points, corners)
    return writer.encoded()


def glb_of_levels(levels: Sequence[tuple[np.ndarray, np.ndarray, SurfaceColors]], coverage: Sequence[float]) -> bytes:
    """Encode levels of detail as GLB with the extension ``MSFT_lod``: vertices, faces and colours, the finest first.

    ``coverage`` has the least share of the screen that each is for; the last hides the mesh below it.
    """
    file, used, meshes = GlbFile(), {_LEVELS}, []
    for points, corners, surface in levels:
        writer = _Writer(surface, None, file)
        writer.add_all(points, corners)
        used |= writer.extensions
        meshes.append({"primitives": writer.primitives})
    nodes: list[dict[str, Any]] = [{"mesh": number} for number in range(len(meshes))]
    nodes[0] |= {
        "extensions": {_LEVELS: {"ids": list(range(1, len(meshes)))}},
        "extras": {"MSFT_screencoverage": list(coverage)},
    }
    return file.encoded([], meshes=meshes, nodes=nodes, extensionsUsed=sorted(used))


class _Writer:
    """Adds a mesh to a file."""

    def __init__(self, surface: SurfaceColors, rig: RigFile | None, file: GlbFile) -> None:
        self._surface, self._rig = surface, rig
        self._file = file
        self.primitives: list[dict[str, Any]] = []
        self._known: dict[Any, int] = {}  # numbers of textures, samplers and images
        self.extensions: set[str] = set()

    def add_all(self, points: np.ndarray, corners: np.ndarray) -> None:
        """Add vertices [V, 3] and faces [F, 3]: a primitive for each image and material."""
        surface = self._surface
        material = np.full(len(corners), -1) if surface.material is None else surface.material
        pairs, group = np.unique(np.stack((surface.image, material), 1), axis=0, return_inverse=True)
        for number, (image, material_number) in enumerate(pairs.tolist()):
            self.add(points, corners, np.flatnonzero(group.reshape(-1) == number), image, material_number)

    def add(self, points: np.ndarray, corners: np.ndarray, faces: np.ndarray, image: int, material: int) -> None:
        """Add the faces [n] of one image (−1: their colours) and material (−1: matt and two-sided)."""
        surface = self._surface
        properties = _MATT if material < 0 else surface.materials[material]
        color = np.ones(3)
        attributes = {"TEXCOORD_0": surface.uv[faces] * [1, -1] + [0, 1]}
        tints = None if surface.tints is None else surface.tints[faces].astype(np.float64).clip(0, 1)
        if image < 0:
            colors = srgb_to_linear(surface.colors[faces].astype(np.float64).clip(0, 1))
            if (colors == colors[0, 0]).all():
                color = colors[0, 0]
            elif tints is None:
                attributes["COLOR_0"] = colors
            else:
                tints[..., :3] *= colors
        if tints is not None and (tints != 1).any():
            attributes["COLOR_0"] = tints if (tints[..., 3] != 1).any() else tints[..., :3]
        is_display = "COLOR_0" in attributes and tints is None
        for number in range(0 if surface.uv1 is None else surface.uv1.shape[2] // 2):
            further = surface.uv1[faces][..., 2 * number : 2 * number + 2]  # type: ignore[index]
            attributes[f"TEXCOORD_{number + 1}"] = further * [1, -1] + [0, 1]
        for name, values in (("NORMAL", surface.normals), ("TANGENT", surface.tangents)):
            if values is not None and values[faces, :, :3].any(-1).all():
                attributes[name] = values[faces]
        flat = {name: values.reshape(-1, values.shape[-1]).astype("<f4") for name, values in attributes.items()}
        # A glTF vertex has one value of each attribute, so a vertex with several is duplicated.
        first, index = _distinct([corners[faces].reshape(-1), *(part for values in flat.values() for part in values.T)])
        position = points[corners[faces].reshape(-1)[first]].astype("<f4")
        if len(position) > len(np.unique(corners[faces])) and len(points) <= _MOST_NUMBERED:
            flat[NUMBER] = corners[faces].reshape(-1, 1).astype("<f4")
        numbers = {name: self._file.accessor(values[first]) for name, values in flat.items()}
        primitive: dict[str, Any] = {
            "attributes": {"POSITION": self._file.accessor(position, bounds=True), **numbers},
            "indices": self._file.accessor(index.reshape(-1, 1).astype("<u4")),
            "material": self._file.add("materials", self._material(properties, image, color)),
        }
        if is_display:
            primitive["extras"] = {DISPLAY: True}
        if self._rig is not None:
            self._add_skin(primitive, self._rig, corners[faces].reshape(-1)[first])
        self.primitives.append(primitive)

    def _add_skin(self, primitive: dict[str, Any], rig: RigFile, vertices: np.ndarray) -> None:
        """Add the bones and the morph targets of the vertices of a primitive."""
        for begin in range(0, rig.indices.shape[1], 4):
            part = slice(begin, begin + 4)
            for name, values, kind in (("JOINTS", rig.indices, "<u2"), ("WEIGHTS", rig.weights, "<f4")):
                four = np.zeros((len(vertices), 4), kind)
                used = np.where(rig.weights[vertices, part] > 0, values[vertices, part], 0)  # joint 0 where none pulls
                four[:, : used.shape[1]] = used
                primitive["attributes"][f"{name}_{begin // 4}"] = self._file.accessor(four)
        if len(rig.targets):
            moved = rig.targets[:, vertices].astype("<f4")
            primitive["targets"] = [{"POSITION": self._file.accessor(target, bounds=True)} for target in moved]

    def _material(self, properties: dict[str, Any], image: int, color: np.ndarray) -> dict[str, Any]:
        """Describe a material; its base colour is an image of the mesh times a factor, or only the factor."""
        base = np.asarray(properties.get("base_color", (1.0, 1.0, 1.0))) * color
        pbr: dict[str, Any] = {
            "baseColorFactor": [*base.clip(0, 1).tolist(), float(properties.get("opacity", 1.0))],
            "metallicFactor": float(properties.get("metallic", 0.0)),
            "roughnessFactor": float(properties.get("roughness", 1.0)),
        }
        alpha: FileTexture | None = properties.get("opacity_texture")
        wrap: Any = None if alpha is None else alpha.wrap
        pixels = None
        if image >= 0:
            pixels, wrap = self._surface.images[image], self._surface.wraps[image]
        if wrap is not None:
            pbr["baseColorTexture"] = self._texture(pixels, wrap, None if alpha is None else alpha.image)
        if properties.get("metallic_roughness_texture") is not None:
            pbr["metallicRoughnessTexture"] = self._used(properties["metallic_roughness_texture"])
        emissive = np.asarray(properties.get("emissive", (0.0, 0.0, 0.0)), dtype=np.float64).clip(0)
        strength = float(max(1.0, emissive.max()))
        result: dict[str, Any] = {
            "pbrMetallicRoughness": pbr,
            "emissiveFactor": (emissive / strength).tolist(),
            "alphaMode": properties.get("alpha_mode", "OPAQUE"),
            "doubleSided": bool(properties.get("double_sided", True)),
        }
        if properties.get("name"):
            result["name"] = properties["name"]
        if result["alphaMode"] == "MASK":
            result["alphaCutoff"] = float(properties.get("alpha_cutoff", 0.5))
        extensions: dict[str, Any] = {}
        if strength > 1:
            extensions |= self._extended("KHR_materials_emissive_strength", {"emissiveStrength": strength})
        if properties.get("unlit"):
            extensions |= self._extended("KHR_materials_unlit", {})
        if extensions:
            result["extensions"] = extensions
        for name, key in _TEXTURES.items():
            if properties.get(name) is not None:
                result[key] = self._used(properties[name])
        for key, option, factor in (
            ("occlusionTexture", "strength", "occlusion_strength"),
            ("normalTexture", "scale", "normal_scale"),
        ):
            if key in result:
                result[key][option] = float(properties.get(factor, 1.0))
        return result

    def _used(self, texture: FileTexture) -> dict[str, Any]:
        info = self._texture(texture.image, texture.wrap)
        if texture.uv_set:
            info["texCoord"] = texture.uv_set
        transform: dict[str, Any] = {}
        if any(texture.offset):
            transform["offset"] = list(texture.offset)
        if any(one != 1 for one in texture.scale):
            transform["scale"] = list(texture.scale)
        if texture.rotation:
            transform["rotation"] = texture.rotation
        if transform:
            info["extensions"] = self._extended("KHR_texture_transform", transform)
        return info

    def _extended(self, name: str, values: dict[str, Any]) -> dict[str, Any]:
        self.extensions.add(name)
        return {name: values}

    def _texture(self, pixels: np.ndarray | None, wrap: Any, alpha: np.ndarray | None = None) -> dict[str, Any]:
        """Add a texture of an image with its alpha channel, or white if it has none, unless it is known."""
        modes = (wrap, wrap) if isinstance(wrap, str) else tuple(wrap)
        picture = self._number("images", (id(pixels), id(alpha)), lambda: self._image(pixels, alpha))
        options = {"magFilter": LINEAR, "minFilter": 9987, "wrapS": MODES[modes[0]], "wrapT": MODES[modes[1]]}
        sampler = self._number("samplers", modes, lambda: options)
        entry = {"source": picture, "sampler": sampler}
        return {"index": self._number("textures", (picture, sampler), lambda: entry)}

    def _number(self, name: str, key: Any, make: Any) -> int:
        if (name, key) not in self._known:
            self._known[name, key] = self._file.add(name, make())
        return self._known[name, key]

    def _image(self, pixels: np.ndarray | None, alpha: np.ndarray | None) -> dict[str, Any]:
        picture = Image.new("RGB", alpha.shape[1::-1], "white") if pixels is None else _picture(pixels)  # type: ignore[union-attr]
        if alpha is not None:
            mask = _picture(alpha[..., :1])
            size = max(picture.size, mask.size)
            picture, mask = (one if one.size == size else one.resize(size) for one in (picture, mask))
            picture = picture.convert("RGB")
            picture.putalpha(mask)
        return {"mimeType": "image/png", "bufferView": self._file.view(encode_png(np.asarray(picture)))}

    def encoded(self) -> bytes:
        """Encode the file."""
        more: dict[str, Any] = {}
        if self.extensions:
            more["extensionsUsed"] = sorted(self.extensions)
        if self._rig is not None:
            more |= rig_entries(self._rig, self._file.accessor)
            weights = {"weights": self._rig.target_weights.tolist()} if len(self._rig.targets) else {}
            more["meshes"] = [{"primitives": self.primitives, **weights}]
        return self._file.encoded(self.primitives, **more)


def _distinct(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Find the distinct rows of columns [n] each: where each comes first, and its number for all rows [n]."""
    row = np.zeros(len(columns[0]), np.int64)
    first = row[:0]
    for column in columns:  # much faster than sorting whole rows
        values, place = np.unique(column, return_inverse=True)
        _, first, row = np.unique(row * len(values) + place, return_index=True, return_inverse=True)
    return first, row


def _picture(pixels: np.ndarray) -> Image.Image:
    return Image.fromarray(as_bytes(pixels))
