"""What a file paints its faces with, before it becomes texture cubes or images that are sampled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .cubes import bake_corners, bake_image, check_size


@dataclass
class Skin:
    """The colours of F faces.

    colors: [F, 3 corners, 3] float32 in [0, 1], of the faces without an image.
    image: [F] int, which of ``images`` a face shows; -1 for none.
    uv: [F, 3, 2] float64, where on it its corners lie: u to the right, v up, the image over [0, 1]².
    images: [H, W, 3] float32 each, first row on top; wrapping: one of `cubes.WRAPPINGS` for each.
    """

    colors: np.ndarray
    image: np.ndarray
    uv: np.ndarray
    images: list[np.ndarray] = field(default_factory=list)
    wrapping: list[str] = field(default_factory=list)
    _numbers: dict[tuple[int, str], int] = field(default_factory=dict, repr=False)

    @classmethod
    def plain(cls, faces: int, grey: float) -> Skin:
        """One grey for all faces."""
        shape = (faces, 3)
        return cls(np.full((*shape, 3), grey, np.float32), np.full(faces, -1), np.zeros((*shape, 2)))

    @classmethod
    def joined(cls, parts: list[Skin]) -> Skin:
        """The faces of several, in their order."""
        colors, uv = (np.concatenate([getattr(part, name) for part in parts]) for name in ("colors", "uv"))
        skin = cls(colors, np.full(len(colors), -1), uv)
        begin = 0
        for part in parts:
            end = begin + len(part.image)
            numbers = [
                skin._number(image, wrapping) for image, wrapping in zip(part.images, part.wrapping, strict=True)
            ]
            skin.image[begin:end] = np.array([*numbers, -1])[part.image]  # -1 finds the last
            begin = end
        return skin

    def paint(self, faces: np.ndarray, image: np.ndarray, uv: np.ndarray, wrapping: str = "REPEAT") -> None:
        """Let the faces of these numbers show an image; an array that others show already is kept once."""
        self.image[faces] = self._number(image, wrapping)
        self.uv[faces] = uv

    def _number(self, image: np.ndarray, wrapping: str) -> int:
        number = self._numbers.setdefault((id(image), wrapping), len(self.images))
        if number == len(self.images):
            self.images.append(image)
            self.wrapping.append(wrapping)
        return number

    def bake(self, size: int, bilinear: bool = True, pixel_centres: bool = False) -> np.ndarray:
        """Texture cubes [F, T, T, T, 3] float32; see `bake_image`. ValueError if they would be too large."""
        check_size(len(self.image), size)
        cubes = np.empty((len(self.image), size, size, size, 3), dtype=np.float32)
        flat = (self.colors == self.colors[:, :1]).all(axis=(1, 2))
        cubes[flat] = self.colors[flat, 0][:, None, None, None]
        cubes[~flat] = bake_corners(self.colors[~flat], size)
        for number, (image, wrapping) in enumerate(zip(self.images, self.wrapping, strict=True)):
            chosen = self.image == number
            cubes[chosen] = bake_image(image, self.uv[chosen], size, wrapping, bilinear, pixel_centres)
        return cubes
