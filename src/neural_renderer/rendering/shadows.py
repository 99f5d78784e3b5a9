"""Shadows of directional and spot lights, by shadow maps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from ..camera import Camera
from ..camera.parameters import Array, parameter
from ..meshes.batch import mesh_parts
from ..shading.lights import Ambience, Beam, FaceLight, Light
from ..shading.point_lights import SpotLight
from .deferred import fragments

_STEEPEST = 3.0  # slope, depth per width, up to which a lit surface does not shadow itself near a silhouette
_WIDEST = 85.0  # largest angle between a spot light's axis and the border of its map, in degrees


@dataclass(frozen=True, eq=False)
class ShadowedLight(FaceLight, Beam, Ambience):
    """A light with shadows of a mesh. With ``shading="flat"``, the shadow at a face's centre holds for the whole face.

    Ambient light casts no shadow.

    The shadow map stores the depth of the mesh as the light sees it; points behind it are in shadow (Williams,
    "Casting curved shadows on curved surfaces", 1978). Edges are softened by percentage-closer filtering (Reeves,
    Salesin and Cook, "Rendering antialiased shadows with depth maps", 1987): light is weighted by the fraction of
    texels within ``softness`` that do not shadow the point.

    The shadow's position has no gradient to the mesh or the light. Colours and intensities of light and surface have
    gradients, in the shadow and outside. Functions under `torch.compile` get a light from outside.

    Attributes:
        light: `Light`, whose directional part is shadowed, or `SpotLight`, with an ``outer`` angle of at most 85°.
        mesh: The mesh that casts shadows, as in `render`; opaque and two-sided.
        size: Side of the map in pixels.
        softness: Half the width of a shadow's edge, in pixels of the map, at least 0.5.
        bias: Largest distance between the lit surface and the beginning of its shadow, as a fraction of the scene's
            size. Within bodies the shadow begins half-way to the back surface (Woo, "The shadow depth map revisited",
            1992), but not nearer than 3 times the width of its edge, to avoid shadow acne.

    Raises:
        TypeError, ValueError: An attribute does not fit.

    Example:
        >>> lamp = nr.ShadowedLight(nr.Light(0.3, 0.7, direction=(1.0, 2.0, -1.0)), mesh)
        >>> images = nr.render(mesh, camera, 64, light=lamp, shading="smooth")
    """

    light: Any
    mesh: Any
    size: int = 1024
    softness: float = 1.5
    bias: float = 0.05
    _camera: Camera = field(init=False, repr=False)
    _depth: Tensor = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.light, (Light, SpotLight)):
            raise TypeError(f"light: expected a Light or a SpotLight, got {type(self.light).__name__}")
        size = validate.whole("size", self.size, 2)
        if not validate.number("softness", self.softness) >= 0.5:
            raise ValueError(f"softness: expected at least 0.5, got {self.softness}")
        validate.not_negative("bias", self.bias)
        with torch.no_grad():
            vertices, faces, _ = mesh_parts(self.mesh)
            vertices = validate.vertices(vertices).detach().float()
            camera, near, far, extent = self._view(vertices.reshape(-1, 3))
            options: dict[str, Any] = {"near": near, "far": far, "anti_aliasing": False, "gradient": "nmr"}
            layers = fragments((vertices, faces), camera, size, layers=2, **options)
            front, back = (torch.where(layer.mask, layer.depth, math.inf) for layer in layers)
            # Front and back meet at a silhouette, where half-way is too near for neighbouring texels.
            wide = _STEEPEST * (self.softness + 0.5) * self._pixel_width(front, camera, size)
            depth = front + torch.maximum((back - front) / 2, wide).clamp(max=self.bias * extent)
            depth = torch.where(torch.isinf(front), front, depth)
        object.__setattr__(self, "_camera", camera)
        object.__setattr__(self, "_depth", depth)

    def _view(self, points: Tensor) -> tuple[Camera, float, float, float]:
        """Make the light's cameras, which see the whole mesh; return them, the depth range and the mesh's size."""
        low, high = torch.aminmax(points, dim=0)
        middle, radius = (low + high) / 2, max(float((high - low).norm()) / 2, 1e-6)
        if isinstance(self.light, SpotLight):
            outer = float(torch.as_tensor(self.light.outer).max())
            if outer > _WIDEST:
                raise ValueError(f"light: expected an outer angle of at most {_WIDEST:g} degrees, got {outer}")
            position = _rows("position", self.light.position, points)
            axis = functional.normalize(_rows("direction", self.light.direction, points), dim=-1)
            position, axis = torch.broadcast_tensors(position, axis)
            farthest = float((position - middle).norm(dim=-1).max()) + radius
            camera = Camera.look(position, axis, _upright(axis), viewing_angle=outer)
            return camera, 1e-3 * farthest, 1.01 * farthest, 2 * radius
        axis = -functional.normalize(_rows("direction", self.light.direction, points), dim=-1)
        eye = middle - 2 * radius * axis
        camera = Camera.look(eye, axis, _upright(axis), orthographic=True, scale=1 / radius)
        return camera, 0.9 * radius, 3.1 * radius, 2 * radius

    @staticmethod
    def _pixel_width(depth: Tensor, camera: Camera, size: int) -> Tensor:
        """Compute the width of the map's pixels at depths [B, H, W]."""
        if camera.viewing_angle is None:
            return torch.full_like(depth, 2 / (size * float(camera.scale)))
        return depth * (2 * math.tan(math.radians(float(camera.viewing_angle))) / size)

    @torch.no_grad()
    def visibility(self, points: Tensor) -> Tensor:
        """Compute the fraction of the light that reaches points.

        Args:
            points: [B, ..., 3] floating, in world space, as from `VisibleSurface.points`.

        Returns:
            [B, ..., 1] float32 in [0, 1], without a gradient; 1 outside of the map.

        Raises:
            TypeError, ValueError: A type, shape or batch does not fit.

        Example:
            >>> lamp = nr.ShadowedLight(nr.Light(direction=(1.0, 2.0, -1.0)), mesh, size=256)
            >>> lamp.visibility(torch.tensor([[[1.0, 3.0, -1.0], [-0.6, -1.2, 0.6]]])).flatten().round()
            tensor([1., 0.])
        """
        if getattr(points, "ndim", 2) < 2:
            raise ValueError(f"points: expected shape [B, …, 3], got {validate.shape_of(points)}")
        validate.floating("points", points, (*getattr(points, "shape", (1, 3))[:-1], 3))
        flat = points.detach().float().flatten(1, -2)
        if len(self._camera) not in (1, len(flat)) and len(flat) != 1:
            raise ValueError(f"points: expected a batch of 1 or {len(self._camera)} like the light, got {len(flat)}")
        at, depth = self._camera.project(flat, self.size)
        known = torch.isfinite(at).all(-1)
        reach = math.ceil(self.softness)
        at = torch.where(known[..., None], at, 0).clamp(-4 * reach - 4, self.size + 4 * reach + 4)
        map_ = functional.pad(self._depth, (reach + 1,) * 4, value=math.inf)
        width = map_.shape[-1]
        map_ = map_.flatten(1).expand(len(at), -1)
        first = at.floor()
        result = torch.zeros_like(depth)
        for down in range(-reach, reach + 1):
            for right in range(-reach, reach + 1):
                texel = first + torch.tensor([right, down], device=at.device)
                share = self._covered(at[..., 0], texel[..., 0]) * self._covered(at[..., 1], texel[..., 1])
                place = (texel + reach + 1).clamp(0, width - 1).long()
                surface = map_.gather(1, place[..., 1] * width + place[..., 0])
                result += share * (depth <= surface)
        return torch.where(known & (depth > 0), result, 1.0).view(len(at), *points.shape[1:-1], 1)

    def beam(self, points: Tensor) -> tuple[Tensor, Tensor]:
        towards, rgb = self.light.beam(points)
        return towards, rgb * self.visibility(points)

    def ambience(self, directions: Tensor, roughness: Tensor | None = None) -> Tensor:
        if isinstance(self.light, Light):
            return self.light.ambience(directions, roughness)
        return directions.new_zeros(1, 1, 1, 3)

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        lit = self.light.two_sided(corners, mirrored)
        share = self.visibility(corners.mean(2))[:, None]
        if not isinstance(self.light, Light):
            return share * lit
        ambient = replace(self.light, directional=0.0).two_sided(corners, mirrored)
        return ambient + share * (lit - ambient)

    def _covered(self, at: Tensor, texel: Tensor) -> Tensor:
        """Compute the fraction of [at − softness, at + softness] that lies in [texel, texel + 1]."""
        low, high = torch.maximum(at - self.softness, texel), torch.minimum(at + self.softness, texel + 1)
        return (high - low).clamp(min=0) / (2 * self.softness)


def _rows(name: str, value: Array, like: Tensor) -> Tensor:
    """Convert a vector to [1 or B, 3]."""
    return parameter(name, value, (3,), like.dtype, like.device, shared=True).detach().reshape(-1, 3)


def _upright(axis: Tensor) -> Tensor:
    """Choose a vector [B, 3] that is not parallel to the axis."""
    up = torch.zeros_like(axis)
    return up.scatter(-1, axis.abs().argmin(-1, keepdim=True), 1.0)
