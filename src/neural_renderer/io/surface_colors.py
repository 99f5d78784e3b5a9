"""Surface colours read from a file, before baking."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch

from .cubes import bake_corners, bake_image, check_size


@dataclass
class SurfaceColors:
    """Colours of F faces.

    Attributes:
        colors: [F, 3 corners, 3] float32 in [0, 1], for faces without an image.
        image: [F] int, index into ``images``; −1 for a face without an image.
        uv: [F, 3, 2] float64, texture coordinates of the corners: u to the right, v up, the image over [0, 1]².
        images: [H, W, 3] float32 each, row 0 at the top.
        wrapping: One of `cubes.WRAPPINGS` for each image.
    """

    colors: np.ndarray
    image: np.ndarray
    uv: np.ndarray
    images: list[np.ndarray] = field(default_factory=list)
    wrapping: list[str] = field(default_factory=list)
    _numbers: dict[tuple[int, str], int] = field(default_factory=dict, repr=False)

    @classmethod
    def plain(cls, faces: int, grey: float) -> SurfaceColors:
        """Make one grey for all faces."""
        shape = (faces, 3)
        return cls(np.full((*shape, 3), grey, np.float32), np.full(faces, -1), np.zeros((*shape, 2)))

    @classmethod
    def joined(cls, parts: list[SurfaceColors]) -> SurfaceColors:
        """Concatenate the colours of several parts."""
        colors, uv = (np.concatenate([getattr(part, name) for part in parts]) for name in ("colors", "uv"))
        surface = cls(colors, np.full(len(colors), -1), uv)
        begin = 0
        for part in parts:
            end = begin + len(part.image)
            numbers = [
                surface._number(image, wrapping) for image, wrapping in zip(part.images, part.wrapping, strict=True)
            ]
            surface.image[begin:end] = np.array([*numbers, -1])[part.image]  # −1 reads the last entry
            begin = end
        return surface

    def paint(self, faces: np.ndarray, image: np.ndarray, uv: np.ndarray, wrapping: str = "REPEAT") -> None:
        """Assign an image [H, W, 3] and texture coordinates [n, 3, 2] to faces [n]. An array is stored once."""
        self.image[faces] = self._number(image, wrapping)
        self.uv[faces] = uv

    def _number(self, image: np.ndarray, wrapping: str) -> int:
        """Return the index of an image; append it if it is new."""
        number = self._numbers.setdefault((id(image), wrapping), len(self.images))
        if number == len(self.images):
            self.images.append(image)
            self.wrapping.append(wrapping)
        return number

    def bake(self, size: int, bilinear: bool = True, pixel_centers: bool = False) -> np.ndarray:
        """Bake the colours into texture cubes [F, T, T, T, 3] float32; see `bake_image`. ValueError above 8 GiB."""
        check_size(len(self.image), size)
        cubes = np.empty((len(self.image), size, size, size, 3), dtype=np.float32)
        flat = (self.colors == self.colors[:, :1]).all(axis=(1, 2))
        cubes[flat] = self.colors[flat, 0][:, None, None, None]
        cubes[~flat] = bake_corners(torch.from_numpy(self.colors[~flat]), size).numpy()
        for number, (image, wrapping) in enumerate(zip(self.images, self.wrapping, strict=True)):
            chosen = self.image == number
            cubes[chosen] = bake_image(image, self.uv[chosen], size, wrapping, bilinear, pixel_centers)
        return cubes
