"""Materials of a glTF file, in the terms of `Material`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...surface_colors import FileTexture, linear_to_srgb
from ..tree import child, extension, item, label, numbers, whole
from . import specular_glossiness
from .pictures import Pictures

_WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_MODES = ("OPAQUE", "MASK", "BLEND")
_NAMES = {
    "metallicRoughnessTexture": "metallic_roughness_texture",
    "emissiveTexture": "emissive_texture",
    "occlusionTexture": "occlusion_texture",
    "normalTexture": "normal_texture",
}
_SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"


class Slot(NamedTuple):
    """Use of a texture by a material: its sampler, and its texture coordinates before and after the transform."""

    texture: int = 0
    wrap: tuple[str, str] = ("repeat", "repeat")
    uv_set: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    rotation: float = 0.0

    @property
    def transform(self) -> tuple[Any, ...]:
        """Offset, scale and rotation."""
        return self.offset, self.scale, self.rotation

    @property
    def has_transform(self) -> bool:
        """Whether texture coordinates are transformed."""
        return self.transform != ((0.0, 0.0), (1.0, 1.0), 0.0)

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
    """A material of a file by its number, or with None the default one of the specification.

    Attributes, some of them after `make`:
        base: Use of the base colour's texture; None without one.
        factor: RGBA of the base colour, linear.
        image: Base colour [H, W, 3] in display values, times the factor; None without a texture.
        arguments: Of `Material`, with a `FileTexture` in place of each texture.
        further: Sets of texture coordinates, as in the file, that textures need beside that of the base colour.
    """

    def __init__(self, tree: dict[str, Any], number: Any, pictures: Pictures) -> None:
        self._tree, self._pictures = tree, pictures
        self._entry = {} if number is None else item(tree, "materials", number)
        self._pbr = child(self._entry, "pbrMetallicRoughness")
        self._old = extension(self._entry, _SPECULAR_GLOSSINESS)
        if self._old is None:
            self.base = self._slot(self._pbr, "baseColorTexture")
            self.factor = numbers(self._pbr, "baseColorFactor", (1.0,) * 4, most=1.0)
        else:
            self.base = self._slot(self._old, "diffuseTexture")
            self.factor = numbers(self._old, "diffuseFactor", (1.0,) * 4, most=1.0)
        if self.base is not None:
            pictures.expect(self.base.texture, self.factor[:3], self._old is not None)
        slot = None if self._old is None else self._slot(self._old, "specularGlossinessTexture")
        if slot is not None:
            pictures.expect(slot.texture, (1.0,), True)

    def make(self) -> None:
        """Make the pictures and the arguments; as all materials are known by now, their pictures are counted."""
        self.image = None if self.base is None else self._pictures.color(self.base.texture, self.factor[:3])
        self.further: list[int] = []
        self.arguments = self._arguments(label(self._entry, ""))

    @property
    def color(self) -> np.ndarray:
        """The factor of the base colour in display values, [3]."""
        return linear_to_srgb(np.array(self.factor[:3]))

    def _arguments(self, name: str) -> dict[str, Any]:
        entry = self._entry
        mode = entry.get("alphaMode", "OPAQUE")
        mode = mode if mode in _MODES else "OPAQUE"
        emissive = numbers(entry, "emissiveFactor", (0.0, 0.0, 0.0), most=1.0)
        strength = extension(entry, "KHR_materials_emissive_strength") or {}
        (strong,) = numbers(strength, "emissiveStrength", (1.0,))
        normal, occlusion = (child(entry, f"{part}Texture") for part in ("normal", "occlusion"))
        result: dict[str, Any] = {
            "name": name,
            "alpha_mode": mode,
            "opacity": 1.0 if mode == "OPAQUE" else self.factor[3],
            "alpha_cutoff": numbers(entry, "alphaCutoff", (0.5,))[0],
            "metallic": numbers(self._pbr, "metallicFactor", (1.0,), most=1.0)[0],
            "roughness": numbers(self._pbr, "roughnessFactor", (1.0,), most=1.0)[0],
            "emissive": tuple(strong * channel for channel in emissive),
            "normal_scale": numbers(normal, "scale", (1.0,), least=None)[0],
            "occlusion_strength": numbers(occlusion, "strength", (1.0,), most=1.0)[0],
            "double_sided": entry.get("doubleSided") is True,
            "unlit": extension(entry, "KHR_materials_unlit") is not None,
        }
        if mode != "OPAQUE" and self.base is not None:
            alpha = self._pictures.alpha(self.base.texture)
            if alpha is not None and (alpha < 1).any():
                result["opacity_texture"] = FileTexture(alpha, self.base.wrap)
        for key in _NAMES:
            if key == "metallicRoughnessTexture" and self._old is not None:
                continue
            slot = self._slot(self._pbr if key == "metallicRoughnessTexture" else entry, key)
            pixels = None if slot is None else self._pictures.color(slot.texture)
            if slot is not None and pixels is not None:
                self._use(result, key, pixels, slot)
        if self._old is not None:
            self._convert(result, self._old)
        return result

    def _use(self, result: dict[str, Any], key: str, pixels: np.ndarray, slot: Slot) -> None:
        """Add a texture relative to the mesh's coordinates, which have the transform of the base colour."""
        base = self.base or Slot()
        if slot.uv_set == base.uv_set and (not base.has_transform or slot.transform == base.transform):
            rest: tuple[Any, ...] = () if base.has_transform else slot.transform
            result[_NAMES[key]] = FileTexture(pixels, slot.wrap, *rest)
            return
        if slot.uv_set not in self.further:
            self.further.append(slot.uv_set)
        number = 1 + self.further.index(slot.uv_set)
        result[_NAMES[key]] = FileTexture(pixels, slot.wrap, slot.offset, slot.scale, slot.rotation, number)

    def _convert(self, result: dict[str, Any], old: dict[str, Any]) -> None:
        """Set the metallic-roughness model of a material that has the specular-glossiness model."""
        slot = self._slot(old, "specularGlossinessTexture")
        pixels = None if slot is None else self._pictures.rgba(slot.texture)
        together = slot is None or self.base is None or slot[1:] == self.base[1:]
        found = specular_glossiness.converted(
            self.color[None, None] if self.image is None else self.image,
            None if slot is None else pixels,
            numbers(old, "specularFactor", (1.0, 1.0, 1.0), most=1.0),
            numbers(old, "glossinessFactor", (1.0,), most=1.0)[0],
            has_specular="specularFactor" in old or pixels is not None,
            together=together,
        )
        if found.base is not None:
            if found.base.shape[:2] == (1, 1) and self.image is None:
                self.factor = (*specular_glossiness.linear(found.base[0, 0]).tolist(), self.factor[3])
            else:
                self.image, self.base = found.base, self.base if self.image is not None else slot
        if found.metallic_roughness.shape[:2] == (1, 1):
            _, rough, metal = found.metallic_roughness[0, 0].tolist()
            result["roughness"], result["metallic"] = rough, metal
            return
        result["roughness"] = result["metallic"] = 1.0
        self._use(result, "metallicRoughnessTexture", found.metallic_roughness, slot or self.base or Slot())

    def _slot(self, owner: dict[str, Any], name: str) -> Slot | None:
        """Read a texture's sampler and transform; None if the material has no such texture."""
        if name not in owner:
            return None
        info = child(owner, name)
        texture = item(self._tree, "textures", info.get("index"))
        sampler = item(self._tree, "samplers", texture["sampler"]) if "sampler" in texture else {}
        wrap = [_WRAPS.get(whole(sampler, key, 10497), "repeat") for key in ("wrapS", "wrapT")]
        transform = extension(info, "KHR_texture_transform") or {}
        return Slot(
            info["index"],
            (wrap[0], wrap[1]),
            whole(transform, "texCoord", whole(info, "texCoord", 0)),
            numbers(transform, "offset", (0.0, 0.0), least=None),
            numbers(transform, "scale", (1.0, 1.0), least=None),
            numbers(transform, "rotation", (0.0,), least=None)[0],
        )
