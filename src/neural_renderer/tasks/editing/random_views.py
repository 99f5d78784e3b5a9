"""Where an object that is edited is looked at from: random cameras and lamps, the same ones for the same seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ... import validate
from ...camera import Camera, get_points_from_angles
from ...shading.lights import Light

_NEAREST, _FURTHEST = 1.8, 50.0  # however wide the spread, no camera comes into the object, or sees a dot of it
_LAMP_TILT = math.radians(30)  # of the light from the vertical, as published


@dataclass(frozen=True)
class Views:
    """Random views of an object in about [-1, 1]³: any azimuth, an elevation and a distance around given ones.

    Attributes:
        elevation: lowest and highest, in degrees, uniformly between.
        distance: from the camera to the origin, on average, from 1.8 to 50.
        spread: standard deviation of the distance, ≥ 0.
        viewing_angle: half the field of view in degrees.
        light: ambient and directional intensity of a lamp 30° from the vertical in a random direction; None: colours
            are drawn as they are. The paper's are 0.5 and 0.5, in which no vertical wall can be as bright as a bright
            painting; with the default the light on an object is about 1 on average, and its texture has the painting's
            colours.
    """

    elevation: tuple[float, float] = (20.0, 40.0)
    distance: float = 2.732
    spread: float = 0.1
    viewing_angle: float = 30.0
    light: tuple[float, float] | None = (0.75, 0.5)

    def __post_init__(self) -> None:
        low, high = (validate.number("elevation", value) for value in self.elevation)
        if not -90 < low <= high < 90:
            raise ValueError(
                f"elevation: expected two numbers between -90 and 90, the lower one first, got {low} {high}"
            )
        if not _NEAREST <= validate.positive("distance", self.distance) <= _FURTHEST:
            raise ValueError(f"distance: expected a number from {_NEAREST} to {_FURTHEST}, got {self.distance}")
        validate.not_negative("spread", self.spread)
        if self.light is not None and min(validate.number("light", value) for value in self.light) < 0:
            raise ValueError(f"light: expected two numbers of at least 0, got {self.light[0]} {self.light[1]}")

    def sample(self, count: int, generator: torch.Generator) -> tuple[Camera, Light | None]:
        """``count`` random views, on the CPU."""
        elevation, azimuth, lamp = torch.rand(3, count, generator=generator)
        low, high = self.elevation
        distance = self.distance + self.spread * torch.randn(count, generator=generator)
        return self._at(distance.clamp(min=_NEAREST), low + (high - low) * elevation, 360 * azimuth, math.tau * lamp)

    def fixed(self, count: int, offset: float = 0.0, elevation: float | None = None) -> tuple[Camera, Light | None]:
        """``count`` views all around at one elevation (the middle one by default) and the mean distance.

        The azimuth of the first is ``offset`` degrees; the lamp stands to the left behind the viewer.
        """
        turn = 360 / count * torch.arange(count) + offset
        middle = sum(self.elevation) / 2 if elevation is None else elevation
        lamp = torch.deg2rad(45 - turn)
        return self._at(torch.full((count,), self.distance), torch.full((count,), middle), turn, lamp)

    def _at(self, distance: Tensor, elevation: Tensor, azimuth: Tensor, lamp: Tensor) -> tuple[Camera, Light | None]:
        eye = get_points_from_angles(distance, elevation, azimuth)
        camera = Camera.look_at(eye, viewing_angle=self.viewing_angle)
        if self.light is None:
            return camera, None
        ambient, directional = self.light
        flat, up = math.sin(_LAMP_TILT), torch.full_like(lamp, math.cos(_LAMP_TILT))
        return camera, Light(ambient, directional, direction=torch.stack((flat * lamp.sin(), up, flat * lamp.cos()), 1))
