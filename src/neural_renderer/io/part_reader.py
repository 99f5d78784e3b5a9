"""Surface colours and materials of the parts that trimesh reads."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image

from .files import fits_float32
from .gltf.reader import KEPT, GltfMaterial
from .images import unpack
from .surface_colors import SurfaceColors, linear_to_srgb, srgb_to_linear


class PartReader:
    """Reader of the surface colours of the parts of a file, and with ``materials`` of materials, normals and uv1.

    ``tree`` is the JSON of a glTF file; empty for other formats.
    """

    def __init__(self, tree: dict[str, Any], materials: bool) -> None:
        self.tree, self._with_materials = tree, materials
        self._pixels: dict[tuple[float, ...], np.ndarray] = {}  # by image, channels and colour factor
        self._materials: dict[int, dict[str, Any]] = {}

    def surface_colors(
        self, part: Any, corners: np.ndarray, order: list[int], matrix: np.ndarray
    ) -> SurfaceColors | None:
        """Collect the colours of one part, a mesh of trimesh with faces ``corners`` [F, 3], or None if it has none.

        The corners of each face are put into ``order``; ``matrix`` [3, 3] is the linear part of the transform.
        """
        surface = SurfaceColors.plain(len(corners), 1.0)
        own = corners[:, order]
        material = self._paint(surface, part, own)
        if self._with_materials and self.tree:
            self._add_directions(surface, part, own, matrix)
            surface.has_colors = material is not None
            if isinstance(material, GltfMaterial):
                self._add_material(surface, part, own, material)
            return surface
        return None if material is None else surface

    def _paint(self, surface: SurfaceColors, part: Any, corners: np.ndarray) -> GltfMaterial | bool | None:
        """Set colours and images. Returns the part's material if it has one, else whether it has colours, or None."""
        visual = part.visual
        srgb = linear_to_srgb if self.tree else np.asarray  # glTF has linear colours
        kind = visual.kind if visual is not None and visual.defined else None
        if kind == "vertex":
            surface.colors[:] = srgb(visual.vertex_colors[:, :3] / 255)[corners]
            return True
        if kind == "face":
            surface.colors[:] = srgb(visual.face_colors[:, :3] / 255)[:, None]
            return True
        if kind != "texture":
            return None
        material, slot = visual.material, None
        name = str(getattr(material, "name", ""))
        if self.tree and name.isdigit():
            slot = GltfMaterial(self.tree, int(name))
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        factor = getattr(material, "baseColorFactor", None)
        factor = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255
        if slot is not None:
            factor = np.array(slot.factor[:3])
        uv = visual.uv if slot is None or slot.base.uv_set == 0 else _upwards(_attribute(part, "TEXCOORD_1", 2))
        if uv is not None:
            uv = uv if slot is None else slot.base.transformed(np.asarray(uv, dtype=np.float64))
            surface.uv[:] = np.where(fits_float32(uv), uv, 0)[corners]
        if image is not None and uv is not None:
            u, v = ("repeat", "repeat") if slot is None else slot.base.wrap
            wrap = u if u == v else (u, v)
            surface.paint(np.arange(len(corners)), self._image(image, 3, factor), surface.uv.copy(), wrap)
            return slot or True
        if not self.tree and not hasattr(material, "baseColorFactor"):
            factor = np.asarray(material.main_color, dtype=np.float64)[:3] / 255
        surface.colors[:] = srgb(factor)
        shades = getattr(visual, "vertex_attributes", {}).get("color")
        if self.tree and isinstance(shades, np.ndarray) and shades.ndim == 2 and shades.shape[1] in (3, 4):
            full = np.iinfo(shades.dtype).max if shades.dtype.kind in "iu" else 1.0
            shades = np.nan_to_num(shades[:, :3].astype(np.float64) / full).clip(0, 1)
            surface.colors[:] = srgb(shades * factor)[corners]
        return slot or True

    def _image(self, image: Any, channels: int, factor: np.ndarray | None = None) -> np.ndarray:
        """Decode an image to [H, W, channels] float32, in linear light times a factor: RGB, or alpha alone."""
        factor = np.ones(3) if factor is None else factor
        key = (id(image), channels, *factor)
        if key not in self._pixels:
            pixels = unpack("its image", image, transparency=channels == 1)
            if channels == 1:
                pixels = pixels[..., 3:] if pixels.shape[2] == 4 else np.ones_like(pixels[..., :1])
            elif (factor < 1).any():
                pixels = linear_to_srgb(srgb_to_linear(pixels) * factor).astype(np.float32)
            self._pixels[key] = pixels
        return self._pixels[key]

    def _add_material(self, surface: SurfaceColors, part: Any, corners: np.ndarray, material: GltfMaterial) -> None:
        """Set the material of a part, and the texture coordinates that it needs."""

        def image(name: str, channels: int) -> np.ndarray | None:
            found = getattr(part.visual.material, name, None)
            return self._image(found, channels) if isinstance(found, Image.Image) else None

        if material.number not in self._materials:
            self._materials[material.number] = material.arguments(image)
        surface.materials = [self._materials[material.number]]
        surface.material = np.zeros(len(corners), np.int64)
        raw = material.raw_set()
        if raw is not None:
            uv = _upwards(_attribute(part, f"TEXCOORD_{raw}", 2))
            surface.uv1 = np.zeros((len(corners), 3, 2)) if uv is None else uv[corners]

    @staticmethod
    def _add_directions(surface: SurfaceColors, part: Any, corners: np.ndarray, matrix: np.ndarray) -> None:
        """Set normals and tangents, turned as the part is. Those without a direction become 0."""
        determinant = np.linalg.det(matrix)
        normals, tangents = _attribute(part, "NORMAL", 3), _attribute(part, "TANGENT", 4)
        if normals is not None and determinant:
            surface.normals = _unit(normals @ np.linalg.inv(matrix))[corners]
        if tangents is not None:
            sign = np.where(tangents[:, 3:] < 0, -1.0, 1.0) * np.sign(determinant)
            surface.tangents = np.concatenate((_unit(tangents[:, :3] @ matrix.T), sign), -1)[corners]


def _attribute(part: Any, name: str, width: int) -> np.ndarray | None:
    """Return a vertex attribute of a part, [V, width] float64, as the file has it; None without usable values."""
    values = (part.vertex_attributes or {}).get(KEPT[name])
    if not isinstance(values, np.ndarray) or values.shape != (len(part.vertices), width):
        return None
    if values.dtype.kind in "iu":  # normalised
        values = np.maximum(values / np.iinfo(values.dtype).max, -1.0)
    values = values.astype(np.float64)
    return np.where(fits_float32(values), values, 0)


def _upwards(uv: np.ndarray | None) -> np.ndarray | None:
    """Turn texture coordinates [V, 2] from v down to v up."""
    return None if uv is None else np.stack((uv[:, 0], 1 - uv[:, 1]), -1)


def _unit(directions: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        unit = directions / np.where(length > 0, length, 1)
    return np.where(np.isfinite(unit), unit, 0)
