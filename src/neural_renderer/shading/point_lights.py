"""Lights with a position: point lights and spot lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..camera.parameters import Array, Scalar, batch_of, batch_size, parameter, scalar
from ..meshes.normals import face_normals
from .lights import Beam, FaceLight
from .pixels.planes import dot, tinted

_TINY = 1e-12  # smallest squared distance between a light and a point


@dataclass(frozen=True, eq=False)
class PointLight(FaceLight, Beam):
    """Light from one point in all directions, for one scene or for each scene of a batch.

    A white matt surface at distance d that faces the light has the colour ``intensity · color / d^falloff``. An
    intensity of 1 is π candela (``KHR_lights_punctual`` of glTF). Parameters given as tensors get gradients.

    With ``shading="flat"``, the light at a face's centre holds for the whole face.

    Attributes:
        position: [3] or [B, 3] in world units: list, tuple, array or tensor.
        intensity: Number, or tensor [] or [B].
        color: RGB [3] or [B, 3].
        falloff: Exponent of the attenuation with distance: 2 is physical, 0 is none.

    Raises:
        TypeError, ValueError: In drawing, `beam` or `two_sided`, a parameter that does not fit or is not finite.

    Example:
        >>> light = [nr.Light(0.2, 0.0), nr.PointLight((1.0, 2.0, -2.0), intensity=5.0)]
        >>> images = nr.render(mesh, camera, 64, light=light, shading="smooth")
    """

    position: Array = (0.0, 0.0, 0.0)
    intensity: Scalar = 1.0
    color: Array = (1.0, 1.0, 1.0)
    falloff: float = 2.0

    def beam(self, points: Tensor) -> tuple[Tensor, Tensor]:
        power = validate.number("falloff", self.falloff)
        between = self._of(points, "position") - points
        square = dot(between, between).clamp(min=_TINY)
        rgb = self._of(points, "color") * _strength("intensity", self.intensity, points)
        return between * square.rsqrt(), tinted(square ** (-power / 2), rgb)

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        validate.finite("corners", validate.floating("corners", corners, ("B", "F", 3, 3)))
        towards, rgb = self.beam(corners.mean(2))
        facing = dot(face_normals(corners), towards)
        if not mirrored:
            facing = -facing
        return torch.stack((torch.relu(facing) * rgb, torch.relu(-facing) * rgb), 1)

    def _of(self, points: Tensor, name: str) -> Tensor:
        """Return a vector among the parameters as [1 or B, 1, ..., 3], to broadcast with points."""
        value = parameter(name, getattr(self, name), (3,), points.dtype, points.device, shared=True).reshape(-1, 3)
        batch_size(points=len(points), **{name: len(value)})
        return value.reshape(-1, *(1,) * (points.ndim - 2), 3)


@dataclass(frozen=True, eq=False)
class SpotLight(PointLight):
    """Point light restricted to a cone, for one scene or for each scene of a batch.

    Between the inner and the outer cone, the light falls as clamp((cos θ − cos outer) / (cos inner − cos outer), 0, 1)²
    of the angle θ to the axis, as in ``KHR_lights_punctual`` of glTF.

    Attributes:
        position, intensity, color, falloff: As in `PointLight`.
        direction: [3] or [B, 3], world vector along which the light shines, of any length: **away** from the light.
        inner: Angle from the axis in degrees within which the light has full intensity, 0 ≤ inner < outer: number, or
            tensor [] or [B].
        outer: Angle from the axis in degrees beyond which there is no light, at most 180: number or tensor.

    Raises:
        TypeError, ValueError: In drawing, `beam` or `two_sided`, a parameter that does not fit or is not finite.

    Example:
        >>> lamp = nr.SpotLight((0.0, 2.0, -2.0), 6.0, direction=(0.0, -1.0, 1.0), inner=10, outer=20)
        >>> images = nr.render(mesh, camera, 64, light=[nr.Light(0.2, 0.0), lamp], shading="smooth")
        >>> lamp.beam(torch.tensor([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]]))[1][0, :, 0]
        tensor([0.7500, 0.0000])
    """

    direction: Array = (0.0, -1.0, 0.0)
    inner: Scalar = 0.0
    outer: Scalar = 45.0

    def beam(self, points: Tensor) -> tuple[Tensor, Tensor]:
        towards, rgb = super().beam(points)
        axis = self._of(points, "direction")
        length = torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
        cosine = -dot(towards, axis / length.clamp(min=_TINY))
        (first, inner), (last, outer) = (_cosine(name, getattr(self, name), points) for name in ("inner", "outer"))
        if validate.values_are_checked(points):
            if not bool(((inner > outer) & (first >= 0) & (last <= 180)).all()):
                raise ValueError(
                    f"outer: expected an angle above inner, at most 180, got {self.outer} and {self.inner}"
                )
            if not bool((length > _TINY).all()):
                raise ValueError(f"direction: expected a vector of positive length, got {self.direction}")
        return towards, rgb * ((cosine - outer) / (inner - outer)).clamp(0, 1) ** 2


def _strength(name: str, value: Any, points: Tensor) -> Any:
    """Convert a number or a tensor [] or [B] so that it broadcasts with points [B, ..., 3]."""
    found = scalar(name, value, points.dtype, points.device)
    if not isinstance(found, Tensor) or not found.ndim:
        return found
    batch_size(points=len(points), **{name: batch_of(found, 0)})
    return found.reshape(-1, *(1,) * (points.ndim - 1))


def _cosine(name: str, degrees: Any, points: Tensor) -> tuple[Tensor, Tensor]:
    """Convert degrees to a tensor that broadcasts with points; return the tensor and its cosine."""
    angle = torch.as_tensor(_strength(name, degrees, points), dtype=points.dtype)
    return angle, torch.cos(torch.deg2rad(angle))
