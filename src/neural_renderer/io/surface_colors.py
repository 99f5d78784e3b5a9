"""Surface colours read from a file, before baking."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch

from ..base import color_space
from .cubes import bake_corners, bake_image, check_size

_TEXELS_AT_ONCE = 1 << 22


def srgb_to_linear(colors: np.ndarray) -> np.ndarray:
    """Convert display values to linear light, as `base.color_space`."""
    return np.asarray(color_space.srgb_to_linear(_tensor(colors)))


def linear_to_srgb(colors: np.ndarray) -> np.ndarray:
    """Convert linear light to display values, as `base.color_space`."""
    return np.asarray(color_space.linear_to_srgb(_tensor(colors)))


def _tensor(colors: np.ndarray) -> torch.Tensor:
    colors = np.asarray(colors)
    return torch.from_numpy(np.require(colors, None if colors.dtype.kind == "f" else np.float64, ["C", "W"]))


class FileTexture(NamedTuple):
    """A texture of a material, with the attributes of `Texture`; the image is an array."""

    image: np.ndarray
    wrap: str | tuple[str, str] = "repeat"
    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    rotation: float = 0.0
    uv_set: int = 0


@dataclass
class SurfaceColors:
    """Colours of F faces, and their materials: the arguments of `Material`, with a `FileTexture` for each texture."""

    colors: np.ndarray  # [F, 3 corners, 3] float32 in [0, 1], for faces without an image
    image: np.ndarray  # [F] int, index into ``images``; −1 for a face without an image
    uv: np.ndarray  # [F, 3, 2] float64, of the corners: u to the right, v up, the image over [0, 1]²
    images: list[np.ndarray] = field(default_factory=list)  # [H, W, 3] float32 each, row 0 at the top
    wraps: list[Any] = field(default_factory=list)  # wrapping of each image, as in `bake_image`
    materials: list[dict[str, Any]] = field(default_factory=list)  # empty if they were not read
    material: np.ndarray | None = None  # [F] int, index into ``materials``; −1 for none
    normals: np.ndarray | None = None  # [F, 3, 3], of the corners
    tangents: np.ndarray | None = None  # [F, 3, 4], with the sign of the bitangent; 0 for faces without any
    uv1: np.ndarray | None = None  # [F, 3, 2 K], further sets of texture coordinates; 0 for faces without any
    tints: np.ndarray | None = None  # [F, 3, 4] in [0, 1], factors of linear RGB and alpha; 1 for faces without any
    has_colors: bool = True  # the file has colours
    _numbers: dict[tuple[int, Any], int] = field(default_factory=dict, repr=False)
    _opaque: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)

    @classmethod
    def plain(cls, faces: int, grey: float) -> SurfaceColors:
        """Make one grey for all faces."""
        shape = (faces, 3)
        return cls(np.full((*shape, 3), grey, np.float32), np.full(faces, -1), np.zeros((*shape, 2)))

    @classmethod
    def joined(cls, parts: list[SurfaceColors]) -> SurfaceColors:
        """Concatenate the colours of several parts."""
        if len(parts) == 1:
            return parts[0]
        colors, uv = (np.concatenate([getattr(part, name) for part in parts]) for name in ("colors", "uv"))
        surface = cls(colors, np.full(len(colors), -1), uv)
        begin = 0
        for part in parts:
            end = begin + len(part.image)
            numbers = [surface._number(image, wrap) for image, wrap in zip(part.images, part.wraps, strict=True)]
            surface.image[begin:end] = np.array([*numbers, -1])[part.image]  # −1 reads the last entry
            begin = end
        surface._join_materials(parts)
        surface.has_colors = any(part.has_colors for part in parts)
        for name, plain in (("normals", 0), ("tangents", 0), ("uv1", 0), ("tints", 1)):
            known = [getattr(part, name) for part in parts]
            width = max((value.shape[2] for value in known if value is not None), default=0)
            if width:
                filled = [np.full((len(part.image), 3, width), plain, np.float32) for part in parts]
                for whole, value in zip(filled, known, strict=True):
                    if value is not None:
                        whole[..., : value.shape[2]] = value
                setattr(surface, name, np.concatenate(filled))
        return surface

    def _join_materials(self, parts: list[SurfaceColors]) -> None:
        """Collect the materials of several parts. Parts may share one."""
        if not any(part.materials for part in parts):
            return
        places: dict[int, int] = {}
        index = []
        for part in parts:
            for material in part.materials:
                if id(material) not in places:
                    places[id(material)] = len(self.materials)
                    self.materials.append(material)
            numbers = np.array([*(places[id(material)] for material in part.materials), -1])
            index.append(numbers[np.full(len(part.image), -1) if part.material is None else part.material])
        self.material = np.concatenate(index)

    def paint(self, faces: np.ndarray | slice, image: np.ndarray, uv: np.ndarray, wrap: Any = "repeat") -> None:
        """Assign an image [H, W, 3] and texture coordinates [n, 3, 2] to faces [n]. An image is stored once."""
        self.image[faces] = self._number(image, wrap)
        self.uv[faces] = uv

    def opaque(self, image: np.ndarray) -> np.ndarray:
        """Return the first three channels of an image, the same array for the same image."""
        if image.shape[2] == 3:
            return image
        if id(image) not in self._opaque:
            self._opaque[id(image)] = image, np.ascontiguousarray(image[..., :3])
        return self._opaque[id(image)][1]

    def _number(self, image: np.ndarray, wrap: Any) -> int:
        """Return the index of an image; append it if it is new."""
        number = self._numbers.setdefault((id(image), wrap), len(self.images))
        if number == len(self.images):
            self.images.append(image)
            self.wraps.append(wrap)
        return number

    def bake(self, size: int, bilinear: bool = True, pixel_centers: bool = False) -> np.ndarray:
        """Bake the colours into texture cubes [F, T, T, T, 3] float32; see `bake_image`. ValueError above 8 GiB."""
        check_size(len(self.image), size)
        cubes = np.empty((len(self.image), size, size, size, 3), dtype=np.float32)
        flat = (self.colors == self.colors[:, :1]).all(axis=(1, 2))
        cubes[flat] = self.colors[flat, 0][:, None, None, None]
        cubes[~flat] = bake_corners(torch.from_numpy(self.colors[~flat]), size).numpy()
        for number, (image, wrap) in enumerate(zip(self.images, self.wraps, strict=True)):
            chosen = self.image == number
            cubes[chosen] = bake_image(image, self.uv[chosen], size, wrap, bilinear, pixel_centers)
        if self.tints is not None:
            rows = max(1, _TEXELS_AT_ONCE // size**3)
            for start in range(0, len(cubes), rows):  # in parts, to save memory
                part = slice(start, start + rows)
                factors = bake_corners(torch.from_numpy(self.tints[part, :, :3]), size).numpy()
                cubes[part] = linear_to_srgb(srgb_to_linear(cubes[part]) * factors)
        return cubes
