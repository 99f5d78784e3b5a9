"""`RandomViews`: random cameras and lights around an object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ...base import validate
from ...camera import Camera, get_points_from_angles
from ...shading.lights import Light
from .options import PAPER_STYLE

_NEAREST, _FURTHEST = 1.8, 50.0  # limits of the distance: outside the object, and near enough to see it
_LIGHT_TILT = math.radians(30)  # angle of the light to the vertical, as in the published code


@dataclass(frozen=True)
class RandomViews:
    """Distribution of cameras and lights around an object in about [-1, 1]³. Azimuths are uniform.

    Attributes:
        elevation: Least and greatest elevation in degrees, in (-90, 90); uniform between them.
        distance: Mean distance from the camera to the origin, in [1.8, 50].
        spread: Standard deviation of the distance, ≥ 0.
        viewing_angle: Half the field of view in degrees.
        light: Ambient and directional intensity, or None to draw colours unlit. The directional light comes from a
            random azimuth, 30° from the vertical. The paper's intensities are 0.5 and 0.5, where no vertical wall gets
            as bright as a bright painting. With the default, light is 1 on average, so that the texture has the
            painting's colours.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.edit import RandomViews
        >>> cameras, light = RandomViews(light=None).sample(4, torch.Generator().manual_seed(0))
        >>> len(cameras), light
        (4, None)
        >>> cameras, light = RandomViews().fixed(8)
        >>> len(cameras)
        8
    """

    elevation: tuple[float, float] = PAPER_STYLE.elevation
    distance: float = PAPER_STYLE.distance
    spread: float = 0.1
    viewing_angle: float = 30.0
    light: tuple[float, float] | None = PAPER_STYLE.light

    def __post_init__(self) -> None:
        low, high = (validate.number("elevation", value) for value in self.elevation)
        if not -90 < low <= high < 90:
            raise ValueError(f"elevation: expected two numbers between -90 and 90 in ascending order, got {low} {high}")
        if not _NEAREST <= validate.positive("distance", self.distance) <= _FURTHEST:
            raise ValueError(f"distance: expected a number from {_NEAREST} to {_FURTHEST}, got {self.distance}")
        validate.not_negative("spread", self.spread)
        if self.light is not None and min(validate.number("light", value) for value in self.light) < 0:
            raise ValueError(f"light: expected two numbers of at least 0, got {self.light[0]} {self.light[1]}")

    def sample(self, count: int, generator: torch.Generator) -> tuple[Camera, Light | None]:
        """Draw random cameras and their lights.

        Args:
            count: Number of cameras.
            generator: Random numbers, on the CPU.

        Returns:
            ``count`` cameras and as many lights, on the CPU; None in place of lights if ``light`` is None.
        """
        elevation, azimuth, light = torch.rand(3, count, generator=generator)
        low, high = self.elevation
        distance = self.distance + self.spread * torch.randn(count, generator=generator)
        return self._make(distance.clamp(min=_NEAREST), low + (high - low) * elevation, 360 * azimuth, math.tau * light)

    def fixed(self, count: int, offset: float = 0.0, elevation: float | None = None) -> tuple[Camera, Light | None]:
        """Make evenly spaced cameras at the mean distance, lit from the left behind the viewer.

        Args:
            count: Number of cameras.
            offset: Azimuth of the first camera in degrees.
            elevation: Elevation in degrees; by default the middle of the range.

        Returns:
            As `sample`.
        """
        azimuth = 360 / count * torch.arange(count) + offset
        middle = sum(self.elevation) / 2 if elevation is None else elevation
        light = torch.deg2rad(45 - azimuth)
        return self._make(torch.full((count,), self.distance), torch.full((count,), middle), azimuth, light)

    def _make(self, distance: Tensor, elevation: Tensor, azimuth: Tensor, light: Tensor) -> tuple[Camera, Light | None]:
        """Make cameras from angles in degrees, and lights from azimuths in radians, [B] each."""
        eye = get_points_from_angles(distance, elevation, azimuth)
        camera = Camera.look_at(eye, viewing_angle=self.viewing_angle)
        if self.light is None:
            return camera, None
        ambient, directional = self.light
        level, up = math.sin(_LIGHT_TILT), torch.full_like(light, math.cos(_LIGHT_TILT))
        direction = torch.stack((level * light.sin(), up, level * light.cos()), 1)
        return camera, Light(ambient, directional, direction=direction)
