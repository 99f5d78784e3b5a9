"""Lenses of camera files: COLMAP's models by their names."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...io.files import short

# Names of the parameters of each model; both are in COLMAP's order. Models without "fx" have one focal length "f".
MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
    "SIMPLE_DIVISION": "f cx cy k1",
    "DIVISION": "fx fy cx cy k1",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "EUCM": "fx fy cx cy alpha beta",
}
PROJECTIONS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
"""Models that `Camera.projection` has, some with fewer coefficients."""
FISHEYES = ("OPENCV_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE")
"""Models that `Camera.fisheye` has, some with fewer coefficients."""
_OPENCV = ("k1", "k2", "p1", "p2", "k3")  # coefficients of `Camera.projection`


@dataclass(frozen=True)
class Lens:
    """The lens of one image. A missing centre is the image's centre."""

    model: str  # a key of `MODELS`
    values: dict[str, float]  # ``fx``, ``fy``, ``cx`` and ``cy`` in pixels, and the distortion
    size: tuple[float, float] | None = None  # height and width that the values describe; None for the image's own
    field: float | None = None  # horizontal field of view in radians, in place of ``fx``
    viewing_angle: float | None = None  # half the vertical field of view in degrees, in place of ``fx``

    @classmethod
    def of_model(cls, where: str, model: str, parameters: list[float], size: tuple[float, float]) -> Lens:
        """Make a lens from the parameters of one of COLMAP's models; raise ValueError for other models."""
        if model not in MODELS:
            raise ValueError(f"{where}: expected a lens model out of {', '.join(MODELS)}, got {short(model)}")
        names = MODELS[model].split()
        if len(parameters) != len(names):
            raise ValueError(f"{where}: expected {len(names)} parameters of {model}, got {len(parameters)}")
        values = dict(zip(names, parameters, strict=True))
        if "f" in values:
            focal = values.pop("f")
            values |= {"fx": focal, "fy": focal}
        if not (values["fx"] > 0 and values["fy"] > 0):
            raise ValueError(f"{where}: expected focal lengths above 0, got {values['fx']:g} and {values['fy']:g}")
        return cls(model, values, size)

    @property
    def needs_undistortion(self) -> bool:
        """Whether images must be undistorted, because `Camera.projection` does not have the lens."""
        if self.model == "FULL_OPENCV":
            return any(self.values[name] != 0 for name in ("k4", "k5", "k6"))
        return self.model not in PROJECTIONS

    def distortion(self) -> list[float]:
        """Return (k1, k2, p1, p2, k3) of the images; zeros for undistorted images."""
        return [0.0 if self.needs_undistortion else self.values.get(name, 0.0) for name in _OPENCV]

    def intrinsics(self, size: tuple[int, int]) -> list[list[float]]:
        """Return K [3, 3] for an image of this height and width; images may be scaled after their calibration."""
        height, width = self.size or size
        fx = self.values.get("fx", 0.0)
        if self.field is not None:
            fx = width / 2 / math.tan(self.field / 2)
        fy = self.values.get("fy", fx)
        cx, cy = self.values.get("cx", width / 2), self.values.get("cy", height / 2)
        scale_x, scale_y = size[1] / width, size[0] / height
        skew = self.values.get("skew", 0.0)
        return [[fx * scale_x, skew * scale_x, cx * scale_x], [0.0, fy * scale_y, cy * scale_y], [0.0, 0.0, 1.0]]
