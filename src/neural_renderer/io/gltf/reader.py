"""The JSON of a glTF or GLB file: changed so that trimesh keeps what materials need, and its materials.

trimesh reads the geometry and the images. It keeps the name of a material and vertex attributes whose names start with
an underscore. So materials are named by their numbers, and normals, tangents and the second texture coordinates are
given a second name.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..files import fits_float32, short
from ..surface_colors import FileTexture

# Attributes of vertices, and the names under which trimesh keeps them.
KEPT = {"NORMAL": "_NR_NORMAL", "TANGENT": "_NR_TANGENT", "TEXCOORD_0": "_NR_UV0", "TEXCOORD_1": "_NR_UV1"}
NUMBER = "_NR_VERTEX"
"""Attribute of files of this package: the number of the vertex that was duplicated because it has several values."""
PRIMITIVE = "_NR_PRIMITIVE_"
MOST_NUMBERED = 1 << 24  # vertices that float32, the only type for large attributes in glTF, can number
_JSON = 0x4E4F534A
HEADER, CHUNK = 12, 8  # bytes
WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_MODES = ("OPAQUE", "MASK", "BLEND")
_NAMES = {
    "metallicRoughnessTexture": "metallic_roughness_texture",
    "emissiveTexture": "emissive_texture",
    "occlusionTexture": "occlusion_texture",
    "normalTexture": "normal_texture",
}


def prepared(data: bytes, is_binary: bool, rigged: bool = False) -> tuple[bytes, dict[str, Any]]:
    """Change the content of a file as described above; return it and the JSON as it was. Damaged files raise any error.

    With ``rigged``, nodes are named by their numbers, and each primitive has an attribute whose name has its number.
    """
    text, rest = data, b""
    if is_binary:
        length, kind = struct.unpack_from("<II", data, HEADER)
        if kind != _JSON:
            raise ValueError("its first chunk is not JSON")
        begin = HEADER + CHUNK
        text, rest = data[begin : begin + length], data[begin + length :]
    tree = json.loads(text)
    original = json.loads(text)
    if not isinstance(tree, dict):
        raise ValueError("its JSON is not an object")
    for number, material in enumerate(dicts(tree, "materials")):
        material["name"] = str(number)
    for number, node in enumerate(dicts(tree, "nodes") if rigged else ()):
        node["name"] = str(number)
    for mesh in dicts(tree, "meshes"):
        for number, primitive in enumerate(dicts(mesh, "primitives")):
            attributes = primitive.get("attributes")
            if isinstance(attributes, dict):
                attributes |= {KEPT[name]: attributes[name] for name in KEPT if name in attributes}
                if rigged and "POSITION" in attributes:
                    attributes[f"{PRIMITIVE}{number}"] = attributes["POSITION"]
    changed = json.dumps(tree).encode()
    if not is_binary:
        return changed, original
    changed += b" " * (-len(changed) % 4)
    length = HEADER + CHUNK + len(changed) + len(rest)
    return data[:8] + struct.pack("<III", length, len(changed), _JSON) + changed + rest, original


def dicts(tree: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the objects of a list in a JSON object; empty if it is none."""
    values = tree.get(name)
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []


class Slot(NamedTuple):
    """Use of an image by a material: its sampler, and its texture coordinates before and after the transform."""

    wrap: tuple[str, str] = ("repeat", "repeat")
    uv_set: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    rotation: float = 0.0

    @property
    def has_transform(self) -> bool:
        """Whether texture coordinates are transformed."""
        return (self.offset, self.scale, self.rotation) != ((0.0, 0.0), (1.0, 1.0), 0.0)

    def transformed(self, uv: np.ndarray) -> np.ndarray:
        """Transform coordinates [..., 2], v up, as ``KHR_texture_transform`` does those with v down."""
        if not self.has_transform:
            return uv
        with np.errstate(over="ignore", invalid="ignore"):
            u, v = uv[..., 0] * self.scale[0], (1 - uv[..., 1]) * self.scale[1]
            cosine, sine = np.cos(self.rotation), np.sin(self.rotation)
            x, y = cosine * u + sine * v + self.offset[0], cosine * v - sine * u + self.offset[1]
        return np.stack((x, 1 - y), -1)


class GltfMaterial:
    """A material in the JSON of a file, by its number."""

    def __init__(self, tree: dict[str, Any], number: int) -> None:
        self._tree, self.number = tree, number
        self._material = _object(item(tree, "materials", number))
        self._pbr = _object(self._material.get("pbrMetallicRoughness", {}))
        self.base = self._slot(self._pbr, "baseColorTexture") or Slot()
        self.factor = numbers(self._pbr, "baseColorFactor", (1.0, 1.0, 1.0, 1.0), most=1.0)
        mode = self._material.get("alphaMode", "OPAQUE")
        self.alpha_mode = mode if mode in _MODES else "OPAQUE"

    def raw_set(self) -> int | None:
        """Find the texture coordinates, as in the file, that textures need beside those of the base colour."""
        for slot in self._others().values():
            if not self._fits_base(slot):
                return slot.uv_set
        return None

    def arguments(self, image: Callable[[str, int], np.ndarray | None]) -> dict[str, Any]:
        """Collect the arguments of a `Material`, with a `FileTexture` in place of each texture.

        ``image`` returns the image [H, W, channels] of a texture by its name in glTF, or None: the alpha channel if it
        is asked for one channel.
        """
        material, pbr = self._material, self._pbr
        emissive = numbers(material, "emissiveFactor", (0.0, 0.0, 0.0), most=1.0)
        extensions = _object(material.get("extensions", {}))
        strength = _object(extensions.get("KHR_materials_emissive_strength", {}))
        (strong,) = numbers(strength, "emissiveStrength", (1.0,))
        normal, occlusion = (_object(material.get(f"{name}Texture", {})) for name in ("normal", "occlusion"))
        result: dict[str, Any] = {
            "name": short(str(material.get("name", "")))[1:-1],
            "alpha_mode": self.alpha_mode,
            "opacity": 1.0 if self.alpha_mode == "OPAQUE" else self.factor[3],
            "alpha_cutoff": numbers(material, "alphaCutoff", (0.5,))[0],
            "metallic": numbers(pbr, "metallicFactor", (1.0,), most=1.0)[0],
            "roughness": numbers(pbr, "roughnessFactor", (1.0,), most=1.0)[0],
            "emissive": tuple(strong * channel for channel in emissive),
            "normal_scale": numbers(normal, "scale", (1.0,), least=None)[0],
            "occlusion_strength": numbers(occlusion, "strength", (1.0,), most=1.0)[0],
            "double_sided": material.get("doubleSided") is True,
        }
        if self.alpha_mode != "OPAQUE":
            alpha = image("baseColorTexture", 1)
            if alpha is not None and (alpha < 1).any():
                result["opacity_texture"] = FileTexture(alpha, self.base.wrap)
        for name, slot in self._others().items():
            pixels = image(name, 3)
            if pixels is not None:
                result[_NAMES[name]] = self._texture(pixels, slot)
        return result

    def _texture(self, pixels: np.ndarray, slot: Slot) -> FileTexture:
        """Describe a texture relative to the mesh's coordinates, which have the transform of the base colour."""
        if self._fits_base(slot):
            same = self.base.has_transform
            return FileTexture(pixels, slot.wrap) if same else FileTexture(pixels, slot.wrap, *slot[2:])
        return FileTexture(pixels, slot.wrap, *slot[2:], uv_set=1)

    def _fits_base(self, slot: Slot) -> bool:
        """Test whether a texture's coordinates follow from those of the base colour."""
        return slot.uv_set == self.base.uv_set and (not self.base.has_transform or slot[2:] == self.base[2:])

    def _others(self) -> dict[str, Slot]:
        owners = {"metallicRoughnessTexture": self._pbr}
        slots = {name: self._slot(owners.get(name, self._material), name) for name in _NAMES}
        return {name: slot for name, slot in slots.items() if slot is not None}

    def _slot(self, owner: dict[str, Any], name: str) -> Slot | None:
        """Read a texture's sampler and transform; None if the material has no such texture."""
        info = owner.get(name)
        if not isinstance(info, dict):
            return None
        texture = _object(item(self._tree, "textures", info.get("index")))
        sampler = _object(item(self._tree, "samplers", texture["sampler"])) if "sampler" in texture else {}
        wrap = tuple(WRAPS.get(sampler.get(key, 10497), "repeat") for key in ("wrapS", "wrapT"))
        transform = _object(_object(info.get("extensions", {})).get("KHR_texture_transform", {}))
        uv_set = transform.get("texCoord", info.get("texCoord", 0))
        return Slot(
            (wrap[0], wrap[1]),
            uv_set if uv_set in (0, 1) else 0,
            numbers(transform, "offset", (0.0, 0.0), least=None),
            numbers(transform, "scale", (1.0, 1.0), least=None),
            numbers(transform, "rotation", (0.0,), least=None)[0],
        )


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"expected an object in its JSON, got {short(value)}")
    return value


def item(tree: dict[str, Any], name: str, number: Any) -> Any:
    """Return an entry of a list in the JSON of a file; raise ValueError if there is none of this number."""
    values = tree.get(name)
    count = len(values) if isinstance(values, list) else 0
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < count:
        raise ValueError(f"expected one of its {count} {name}, got {short(number)}")
    return values[number]  # type: ignore[index]


def numbers(
    owner: dict[str, Any], name: str, default: tuple[float, ...], least: float | None = 0.0, most: float | None = None
) -> Any:
    """Read a number, or a list of as many as ``default`` has; numbers out of range become the nearest in it."""
    value = owner.get(name, default)
    values = value if isinstance(value, (list, tuple)) else [value]
    known = all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in values)
    if not known or len(values) != len(default) or not all(abs(number) < 1e38 for number in values):
        raise ValueError(f"expected {len(default)} finite numbers as {name}, got {short(value)}")
    found = np.array([float(number) for number in values])
    if not fits_float32(found).all():
        raise ValueError(f"expected finite numbers as {name}, got {short(value)}")
    return tuple(float(number) for number in np.clip(found, least, most))
