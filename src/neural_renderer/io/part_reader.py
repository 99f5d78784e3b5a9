"""Surface colours of the parts that trimesh reads."""

from __future__ import annotations

from typing import Any

import numpy as np

from .files import fits_float32
from .images import unpack
from .surface_colors import SurfaceColors, linear_to_srgb, srgb_to_linear


class PartReader:
    """Reader of the surface colours of the parts of a mesh of trimesh."""

    def __init__(self) -> None:
        self._pixels: dict[tuple[float, ...], np.ndarray] = {}  # by image and colour factor

    def surface_colors(self, part: Any, corners: np.ndarray, order: list[int]) -> SurfaceColors | None:
        """Collect the colours of one part, a mesh of trimesh with faces ``corners`` [F, 3], or None if it has none.

        The corners of each face are put into ``order``.
        """
        surface = SurfaceColors.plain(len(corners), 1.0)
        return surface if self._paint(surface, part, corners[:, order]) else None

    def _paint(self, surface: SurfaceColors, part: Any, corners: np.ndarray) -> bool:
        """Set colours and images; return whether the part has any."""
        visual = part.visual
        kind = visual.kind if visual is not None and visual.defined else None
        if kind == "vertex":
            surface.colors[:] = (visual.vertex_colors[:, :3] / 255)[corners]
        elif kind == "face":
            surface.colors[:] = (visual.face_colors[:, :3] / 255)[:, None]
        elif kind == "texture":
            self._paint_material(surface, visual, corners)
        return kind in ("vertex", "face", "texture")

    def _paint_material(self, surface: SurfaceColors, visual: Any, corners: np.ndarray) -> None:
        material = visual.material
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        factor = getattr(material, "baseColorFactor", None)
        factor = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255
        if visual.uv is not None:
            surface.uv[:] = np.where(fits_float32(visual.uv), visual.uv, 0)[corners]
            if image is not None:
                surface.paint(np.arange(len(corners)), self._image(image, factor), surface.uv.copy())
                return
        if not hasattr(material, "baseColorFactor"):
            factor = np.asarray(material.main_color, dtype=np.float64)[:3] / 255
        surface.colors[:] = factor

    def _image(self, image: Any, factor: np.ndarray) -> np.ndarray:
        """Decode an image to [H, W, 3] float32, in linear light times a factor."""
        key = (id(image), *factor)
        if key not in self._pixels:
            pixels = unpack("its image", image, transparency=False)
            if (factor < 1).any():
                pixels = linear_to_srgb(srgb_to_linear(pixels) * factor).astype(np.float32)
            self._pixels[key] = pixels
        return self._pixels[key]
