"""`CameraFile`, the common form of all formats: images, each with a pose and a lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..camera import Camera
from .lens_models import Lens


@dataclass(frozen=True)
class PosedImage:
    """An entry of a camera file. A world point X is at rotation · X + translation: x right, y down, z forward."""

    where: str  # place in the file, for messages
    name: str  # of the image, as in the file
    rotation: Tensor  # [3, 3] float64
    translation: Tensor  # [3] float64
    lens: Lens
    mask: str | None = None  # name of the mask


@dataclass(frozen=True)
class CameraFile:
    """A camera file."""

    path: Path
    images: Sequence[PosedImage]
    folders: tuple[Path, ...]  # folders of the images, in the order of search
    points: Tensor | None = None  # [P, 3] float64, in the world
    convention: str = "world-to-camera, in OpenCV's axes"  # axes of the matrices in the file, for messages

    def poses(self) -> tuple[Tensor, Tensor]:
        """Return rotations [N, 3, 3] and translations [N, 3] of all images, float32."""
        rotations, translations = zip(*((image.rotation, image.translation) for image in self.images), strict=True)
        return torch.stack(rotations).float(), torch.stack(translations).float()

    def cameras(self, size: tuple[int, int] | None = None) -> Camera:
        """Make the cameras of all images; ``size``, their height and width, is needed if the file lacks it.

        Lenses that `Camera` does not have become pinholes with the same K; see `undistort`. ValueError: There is no
        size, or kinds of lenses are mixed.
        """
        rotation, translation = self.poses()
        angles = [image.lens.viewing_angle for image in self.images]
        if all(angle is not None for angle in angles):
            pose = torch.cat((rotation, translation[:, :, None]), 2)
            return Camera.from_matrix(world_to_camera=pose, viewing_angle=torch.tensor(angles))
        first = self.images[0].lens.size
        full = size or (None if first is None else (round(first[0]), round(first[1])))
        if full is None:
            raise ValueError(f"{self.path}: expected the size of the images in the file or as an argument, got none")
        K = torch.tensor([image.lens.intrinsics(full) for image in self.images])
        distortion = torch.tensor([image.lens.distortion() for image in self.images])
        coefficients = distortion if bool(distortion.any()) else None
        try:
            return Camera.projection(K, rotation, translation, coefficients, orig_size=full)
        except ValueError as error:  # focal lengths that no camera has
            raise ValueError(f"{self.path}: {error}") from None
