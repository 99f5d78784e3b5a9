"""Camera files of all formats as one class: images, each with a pose and a lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from ..camera import Camera
from .lens_models import Lens


@dataclass(frozen=True)
class PosedImage:
    """An entry of a camera file.

    Attributes:
        where: Place in the file, for messages.
        name: Name of the image, as in the file.
        rotation: [3, 3] float64, from the world to the camera; x right, y down, z forward, as in OpenCV.
        translation: [3] float64; a world point X is at rotation · X + translation.
        lens: The lens.
        mask: Name of the mask, or None.
    """

    where: str
    name: str
    rotation: Tensor
    translation: Tensor
    lens: Lens
    mask: str | None = None


@dataclass(frozen=True)
class CameraFile:
    """A camera file.

    Attributes:
        path: The file.
        images: Its entries.
        folders: Folders that may contain the images, in the order of search.
        points: [P, 3] float64, points of the scene in the world, or None.
        convention: Axes and direction of the matrices in the file, for messages.
    """

    path: Path
    images: Sequence[PosedImage]
    folders: tuple[Path, ...]
    points: Tensor | None = field(default=None)
    convention: str = "world-to-camera, in OpenCV's axes"

    def cameras(self, size: tuple[int, int] | None = None) -> Camera:
        """Make the cameras of all images; ``size``, their height and width, is needed if the file does not tell it.

        Lenses that `Camera` does not express are pinholes with the same K; see `undistort`. ValueError: There is no
        size, or kinds of lenses are mixed.
        """
        rotation = torch.stack([image.rotation for image in self.images]).float()
        translation = torch.stack([image.translation for image in self.images]).float()
        angles = [image.lens.viewing_angle for image in self.images]
        if all(angle is not None for angle in angles):
            pose = torch.cat((rotation, translation[:, :, None]), 2)
            return Camera.from_matrix(world_to_camera=pose, viewing_angle=torch.tensor(angles))
        first = self.images[0].lens.size
        full = size or (None if first is None else (round(first[0]), round(first[1])))
        if full is None:
            raise ValueError(f"{self.path}: expected the size of the images, got neither that nor the images")
        K = torch.tensor([image.lens.intrinsics(full) for image in self.images])
        distortion = torch.tensor([image.lens.distortion() for image in self.images])
        coefficients = distortion if bool(distortion.any()) else None
        return Camera.projection(K, rotation, translation, coefficients, orig_size=full)
