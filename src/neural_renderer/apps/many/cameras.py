"""Cameras of a model in a data set: on orbits, random on a sphere, or from a file."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from ...camera import Camera, get_points_from_angles
from ...camera.files.load import load_cameras
from ..common.pictures.outputs import distance_to_see
from .options import DatasetOptions


@dataclass(frozen=True)
class CameraPlan:
    """Choice of the cameras of each model.

    The kind "orbit" is ``views`` cameras around the y axis at each elevation, from ``azimuth`` on; "sphere" is
    ``views`` cameras in random directions, uniform between the least and the greatest elevation; other kinds are the
    path of a file of cameras in the world of the drawn mesh. Angles are in degrees, as in `get_points_from_angles`.
    """

    kind: str = "orbit"
    views: int = DatasetOptions.views  # number of cameras on each orbit, or on the sphere
    elevation: tuple[float, ...] = (20.0,)
    azimuth: float = DatasetOptions.azimuth
    # Distance from the origin; None for one at which the whole mesh is visible.
    distance: float | None = DatasetOptions.distance
    viewing_angle: float = DatasetOptions.viewing_angle  # half of the vertical field of view
    seed: int = DatasetOptions.seed  # seed of random directions, together with the model's name

    @property
    def is_file(self) -> bool:
        """Return whether ``kind`` is the path of a file."""
        return self.kind not in ("orbit", "sphere")

    def make(self, name: str, radius: float, size: tuple[int, int], draw: int = 0) -> tuple[Camera, list[str]]:
        """Make the cameras of a model, and describe how each was chosen.

        Random directions depend on its name, the seed and the number of the ``draw`` only. The radius is that of the
        mesh around the origin; the size is height and width of the images. ValueError: A file of cameras is malformed.
        """
        if self.is_file:
            camera = _load(self.kind, size)
            return camera, [f"camera {number} of {Path(self.kind).name}" for number in range(len(camera))]
        distance = self.distance or distance_to_see(radius, self.viewing_angle, size[1] / size[0])
        if self.kind == "orbit":
            steps = self.azimuth + 360 * np.arange(self.views) / self.views
            azimuth, elevation = np.tile(steps, len(self.elevation)), np.repeat(np.array(self.elevation), self.views)
        else:
            random = generator(name, self.seed, draw).random((2, self.views))
            low, high = (math.sin(math.radians(bound(self.elevation))) for bound in (min, max))
            azimuth, elevation = 360 * random[0], np.degrees(np.arcsin(low + (high - low) * random[1]))
        azimuths, heights = (torch.from_numpy(part.astype(np.float32)) for part in (azimuth, elevation))
        eyes = get_points_from_angles(distance, heights, azimuths)
        camera = Camera.look_at(eyes, viewing_angle=self.viewing_angle)
        pairs = zip(azimuth, elevation, strict=True)
        return camera, [f"azimuth {turn % 360:.2f}, elevation {height:.2f}" for turn, height in pairs]


def generator(name: str, *numbers: int) -> np.random.Generator:
    """Make a generator of random numbers that depends on a name and on numbers, and not on the process."""
    text = "/".join([name, *map(str, numbers)])
    return np.random.Generator(np.random.PCG64(int.from_bytes(hashlib.sha256(text.encode()).digest(), "big")))


@lru_cache(maxsize=2)
def _load(path: str, size: tuple[int, int]) -> Camera:
    return load_cameras(Path(path), size)[0]
