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

    @classmethod
    def plain(cls, faces: int, grey: float) -> Skin:
        """One grey for all faces."""
        shape = (faces, 3)
        return cls(np.full((*shape, 3), grey, np.float32), np.full(faces, -1), np.zeros((*shape, 2)))

    @classmethod
    def joined(cls, parts: list[Skin]) -> Skin:
        """The faces of several, in their order."""
        before = np.cumsum([0] + [len(part.images) for part in parts])
        image = [np.where(part.image < 0, -1, part.image + n) for part, n in zip(parts, before, strict=False)]
        return cls(
            np.concatenate([part.colors for part in parts]),
            np.concatenate(image),
            np.concatenate([part.uv for part in parts]),
            [image for part in parts for image in part.images],
            [wrapping for part in parts for wrapping in part.wrapping],
        )

    def paint(self, faces: np.ndarray, image: np.ndarray, uv: np.ndarray, wrapping: str = "REPEAT") -> None:
        """Let the faces of these numbers show an image."""
        self.image[faces] = len(self.images)
        self.uv[faces] = uv
        self.images.append(image)
        self.wrapping.append(wrapping)

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
