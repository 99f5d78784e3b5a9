"""Lights and materials: ambient, diffuse and specular colours."""

from __future__ import annotations

from typing import Any

from torch import Tensor
from torch.nn.functional import normalize, relu

from .properties import TensorProperties

_AMBIENT, _DIFFUSE, _SPECULAR = ((0.5,) * 3,), ((0.3,) * 3,), ((0.2,) * 3,)


def diffuse(normals: Tensor, color: Tensor, direction: Tensor) -> Tensor:
    """Compute `color` · max(n · l, 0)."""
    normals, direction = normalize(normals, dim=-1, eps=1e-6), normalize(_like(direction, normals), dim=-1, eps=1e-6)
    return _like(color, normals) * relu((normals * direction).sum(-1, keepdim=True))


def specular(
    points: Tensor, normals: Tensor, direction: Tensor, color: Tensor, camera_position: Tensor, shininess: Tensor
) -> Tensor:
    """Compute Phong's `color` · max(v · r, 0)^shininess, where the light falls on the front."""
    normals, direction = normalize(normals, dim=-1, eps=1e-6), normalize(_like(direction, normals), dim=-1, eps=1e-6)
    cosine = (normals * direction).sum(-1, keepdim=True)
    view = normalize(_like(camera_position, points) - points, dim=-1, eps=1e-6)
    along = relu((view * (2 * cosine * normals - direction)).sum(-1, keepdim=True)) * (cosine > 0)
    return _like(color, points) * along ** _like(shininess.reshape(-1, 1), points)


class _Lights(TensorProperties):
    ambient_color: Tensor
    diffuse_color: Tensor
    specular_color: Tensor

    def towards(self, points: Tensor) -> Tensor:
        """Return directions to the light."""
        raise NotImplementedError

    def diffuse(self, normals: Tensor, points: Tensor) -> Tensor:
        return diffuse(normals, self.diffuse_color, self.towards(points))

    def specular(self, normals: Tensor, points: Tensor, camera_position: Tensor, shininess: Tensor) -> Tensor:
        return specular(points, normals, self.towards(points), self.specular_color, camera_position, shininess)


class DirectionalLights(_Lights):
    """Distant lights; ``direction`` points towards the light."""

    direction: Tensor

    def __init__(
        self, ambient_color: Any = _AMBIENT, diffuse_color: Any = _DIFFUSE, specular_color: Any = _SPECULAR,
        direction: Any = ((0, 1, 0),), device: Any = "cpu",
    ) -> None:  # fmt: skip
        colors = {"ambient_color": ambient_color, "diffuse_color": diffuse_color, "specular_color": specular_color}
        super().__init__(device, **colors, direction=direction)

    def towards(self, points: Tensor) -> Tensor:
        return self.direction


class PointLights(_Lights):
    """Lamps, whose light does not weaken with the distance."""

    location: Tensor

    def __init__(
        self, ambient_color: Any = _AMBIENT, diffuse_color: Any = _DIFFUSE, specular_color: Any = _SPECULAR,
        location: Any = ((0, 1, 0),), device: Any = "cpu",
    ) -> None:  # fmt: skip
        colors = {"ambient_color": ambient_color, "diffuse_color": diffuse_color, "specular_color": specular_color}
        super().__init__(device, **colors, location=location)

    def towards(self, points: Tensor) -> Tensor:
        return _like(self.location, points) - points


class AmbientLights(_Lights):
    """Light from everywhere, of any number of channels; white by default."""

    def __init__(self, *, ambient_color: Any = None, device: Any = "cpu") -> None:
        super().__init__(device, ambient_color=((1.0,) * 3,) if ambient_color is None else ambient_color)

    def diffuse(self, normals: Tensor, points: Tensor) -> Tensor:
        return points.new_zeros(*points.shape[:-1], self.ambient_color.shape[-1])

    def specular(self, normals: Tensor, points: Tensor, camera_position: Tensor, shininess: Tensor) -> Tensor:
        return self.diffuse(normals, points)


class Materials(TensorProperties):
    """Factors of the three colours, and the exponent of highlights."""

    ambient_color: Tensor
    diffuse_color: Tensor
    specular_color: Tensor
    shininess: Tensor

    def __init__(
        self, ambient_color: Any = ((1, 1, 1),), diffuse_color: Any = ((1, 1, 1),), specular_color: Any = ((1, 1, 1),),
        shininess: Any = 64, device: Any = "cpu",
    ) -> None:  # fmt: skip
        colors = {"ambient_color": ambient_color, "diffuse_color": diffuse_color, "specular_color": specular_color}
        super().__init__(device, **colors, shininess=shininess)


def lit(
    points: Tensor, normals: Tensor, lights: Any, cameras: Any, materials: Materials
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Return the factors of colours and the highlights at points [N, ..., 3]."""
    eye = cameras.get_camera_center()
    ambient = _like(materials.ambient_color * lights.ambient_color, points)
    plain = _like(materials.diffuse_color, points) * lights.diffuse(normals=normals, points=points)
    shine = lights.specular(normals=normals, points=points, camera_position=eye, shininess=materials.shininess)
    return ambient + plain, _like(materials.specular_color, points) * shine


def _like(value: Tensor, points: Tensor) -> Tensor:
    """Insert dimensions into [N, C], so that it fits points [N, ..., 3]."""
    return value.view(len(value), *[1] * (points.ndim - 2), value.shape[-1]) if value.ndim == 2 < points.ndim else value
