"""Ambient and directional light with flat shading (section "Lighting" of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Protocol, TypeAlias, runtime_checkable

import torch
from torch import Tensor

from ..base import validate
from ..camera import Camera
from ..camera.parameters import Array, Scalar, batch_size, parameter, scalar
from ..meshes.normals import face_normals
from ..meshes.uv_mesh import UVMesh
from ..raster.faces import corner_indices, world_corners
from ..raster.ops.flat_light import flat_light
from ..raster.warp.kept import kept_with
from ..raster.warp.registration import is_eager, is_plain

# The package's lights derive from these protocols and inherit the docstrings of their methods.


@runtime_checkable
class FaceLight(Protocol):
    """A light that is constant on each face, for `shading="flat"`: `Light`, `SphericalHarmonicLight`, …."""

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        """Compute the light on both sides of each face.

        Args:
            corners: [B, F, 3 corners, 3] floating, corners of faces in world space.
            mirrored: Whether the camera's image is mirrored (`Camera.mirrored`).

        Returns:
            [B, 2, F, 3]: RGB factors. Index 0 is the side visible when corners run counter-clockwise on the screen:
            the side of (v1 − v0) × (v2 − v0), or the opposite one for a mirrored camera. Index 1 is the back.

        Raises:
            TypeError, ValueError: A type or shape does not fit; while values are checked, also a number or parameter
                that is not finite.

        Example:
            >>> corners = nr.vertices_to_faces(mesh.vertices[None], mesh.faces)
            >>> nr.Light(ambient=1.0, directional=0.0).two_sided(corners).shape
            torch.Size([1, 2, 320, 3])
        """


@runtime_checkable
class Beam(Protocol):
    """A light that reaches each point from one direction: `Light`, `PointLight`, `SpotLight`.

    Per-pixel shading (`shading="smooth"` and others) calls a light's methods `beam` and `ambience`; one suffices.
    """

    def beam(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Compute direction and colour of the light that reaches points.

        Args:
            points: [B, ..., 3] floating, in world space.

        Returns:
            Unit vectors towards the light and RGB of the light on a white matt surface that faces it, differentiable in
            points and parameters: [B, ..., 3] each, or [1 or B, 1, 1, 3] of a `Light`, the same at all points.

        Raises:
            TypeError, ValueError: A type, shape or parameter does not fit.

        Example:
            >>> towards, rgb = nr.Light(direction=(0.0, 2.0, 0.0)).beam(torch.zeros(1, 8, 8, 3))
            >>> towards[0, 0, 0], rgb[0, 0, 0]
            (tensor([0., 1., 0.]), tensor([1., 1., 1.]))
            >>> nr.PointLight((0.0, 2.0, 0.0)).beam(torch.zeros(1, 3))
            (tensor([[0., 1., 0.]]), tensor([[0.2500, 0.2500, 0.2500]]))
        """


@runtime_checkable
class Ambience(Protocol):
    """A light from all directions: `Light`, `SphericalHarmonicLight`, `EnvironmentLight`."""

    def ambience(self, directions: Tensor, roughness: Tensor | None = None) -> Tensor:
        """Compute the irradiance of matt surfaces, or the radiance of blurred reflections.

        Args:
            directions: [B, H, W, 3] floating unit vectors: normals, or with roughness directions of reflection.
            roughness: [B, H, W, 1] floating in [0, 1], or None for matt surfaces. A `Light` does not use it.

        Returns:
            RGB, differentiable in all arguments and parameters: [B, H, W, 3] ≥ 0, or [1 or B, 1, 1, 3] where the light
            is equal from all directions.

        Raises:
            TypeError, ValueError: A type, shape or parameter does not fit.

        Example:
            >>> nr.Light(ambient=0.25).ambience(torch.zeros(1, 8, 8, 3))
            tensor([[[[0.2500, 0.2500, 0.2500]]]])
            >>> light = nr.EnvironmentLight(torch.ones(16, 32, 3))
            >>> light.ambience(torch.nn.functional.normalize(torch.randn(1, 8, 8, 3), dim=-1)).mean()
            tensor(1.0000)
        """


AnyLight: TypeAlias = FaceLight | Beam | Ambience
_WHITE = (1.0, 1.0, 1.0)
_UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Light(FaceLight, Beam, Ambience):
    """Ambient and directional light, for one scene or for each scene of a batch.

    A face is lit by ambient · ambient_color + directional · directional_color · max(n · direction, 0), where n is the
    unit normal of its visible side. Parameters given as tensors get gradients.

    Attributes:
        ambient: Ambient intensity: number, or tensor [] or [B].
        directional: Directional intensity: number, or tensor [] or [B].
        ambient_color: RGB [3] or [B, 3]: list, tuple, array or tensor.
        directional_color: RGB [3] or [B, 3].
        direction: [3] or [B, 3], world vector **towards** the light. It is not normalised: its length scales the light.

    Raises:
        TypeError, ValueError: In drawing or `two_sided`, a parameter that does not fit or is not finite.

    Example:
        >>> light = nr.Light(ambient=0.3, directional=0.7, direction=(1.0, 1.0, 0.0))
        >>> images = nr.render(mesh, camera, light=light)
    """

    ambient: Scalar = 0.5
    directional: Scalar = 0.5
    ambient_color: Array = _WHITE
    directional_color: Array = _WHITE
    direction: Array = _UP

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        facing = self._facing(corners)
        if not mirrored:
            facing = -facing
        return self._shade(torch.stack((facing, -facing), dim=1))

    def beam(self, points: Tensor) -> tuple[Tensor, Tensor]:
        _, directional, direction = self._parameters(points.dtype, points.device, len(points))
        length = torch.linalg.vector_norm(direction, dim=-1, keepdim=True)
        towards = direction / length.clamp(min=torch.finfo(length.dtype).tiny)
        return towards[:, None, None], (directional * length)[:, None, None]

    def ambience(self, directions: Tensor, roughness: Tensor | None = None) -> Tensor:
        return self._parameters(directions.dtype, directions.device, len(directions))[0][:, None, None]

    def _facing(self, corners: Tensor) -> Tensor:
        """Compute n · direction of each face, [B, F], with the orientation of `face_normals`."""
        validate.finite("corners", validate.floating("corners", corners, ("B", "F", 3, 3)))
        if self._is_ambient:
            return corners.new_zeros(corners.shape[:2])
        _, _, direction = self._parameters(corners.dtype, corners.device, len(corners))
        return (face_normals(corners) * direction[..., None, :]).sum(-1)

    def _shade(self, facing: Tensor) -> Tensor:
        """Compute light [B, ..., 3] from n · direction [B, ...]."""
        ambient, directional, _ = self._parameters(facing.dtype, facing.device, len(facing))
        across = (-1, *(1,) * (facing.ndim - 1), 3)
        return ambient.reshape(across) + directional.reshape(across) * torch.relu(facing)[..., None]

    @property
    def _is_ambient(self) -> bool:
        """True if the directional intensity is the number 0; the direction is then unused."""
        return isinstance(self.directional, (int, float)) and self.directional == 0

    def _parameters(self, dtype: torch.dtype, device: torch.device, images: int) -> tuple[Tensor, Tensor, Tensor]:
        """Convert the parameters to tensors [1 or B, 3]: RGB of ambient and of directional light, and the direction.

        TypeError, ValueError: A type or shape does not fit B images or meshes; while values are checked, also a number
        that is not finite.
        """
        towards = (0.0, 0.0, 0.0) if self._is_ambient else self.direction
        direction = parameter("direction", towards, (3,), dtype, device, shared=True).reshape(-1, 3)
        parts = self._rgb("ambient", dtype, device), self._rgb("directional", dtype, device), direction
        names = ("ambient_color", "directional_color", "direction")
        batch_size(corners=images, **{name: len(part) for name, part in zip(names, parts, strict=True)})
        return parts

    def _rgb(self, intensity: str, dtype: torch.dtype, device: torch.device) -> Tensor:
        strength, rgb = getattr(self, intensity), getattr(self, f"{intensity}_color")
        numbers = type(strength) in (int, float) and rgb is _WHITE and is_plain(())
        return (_gray if numbers else _scaled)(intensity, strength, rgb, dtype, device)


def _scaled(intensity: str, strength: Any, rgb: Any, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Multiply a colour by an intensity, [1 or B, 3]."""
    strength = scalar(intensity, strength, dtype, device)
    rgb = parameter(f"{intensity}_color", rgb, (3,), dtype, device, shared=True)
    return (rgb * (strength[:, None] if isinstance(strength, Tensor) and strength.ndim else strength)).reshape(-1, 3)


# White light's intensities are cached between calls; not as inference tensors, since a later call may need gradients.
_gray = lru_cache(maxsize=64)(torch.inference_mode(False)(_scaled))


@dataclass(frozen=True, eq=False)
class CameraLight:
    """Ambient light, and directional light fixed to the camera: the default of `render`.

    Attributes:
        ambient: Ambient intensity: number, or tensor [] or [B].
        directional: Directional intensity: number, or tensor [] or [B].
        direction: [3] or [B, 3], towards the light, along the camera's right, up and **backward** axes; its length
            scales the light. The default comes over the viewer's left shoulder, so that no visible face is dark.

    Raises:
        TypeError, ValueError: Raised by `render`: a parameter does not fit.

    Example:
        >>> images = nr.render(mesh, camera, light=nr.CameraLight(direction=(0.0, 0.0, 1.0)))  # a headlight
    """

    ambient: Scalar = 0.4
    directional: Scalar = 0.65
    direction: Array = (-0.4, 0.6, 0.6928)

    def at(self, camera: Camera) -> Light:
        """Convert the light to world space; gradients flow to the cameras.

        Args:
            camera: B cameras.

        Returns:
            Light for B images.

        Raises:
            TypeError, ValueError: The direction does not fit.

        Example:
            >>> nr.CameraLight(direction=(0.0, 1.0, 0.0)).at(nr.Camera.look_at((0.0, 0.0, -2.5))).direction
            tensor([[0., 1., 0.]])
        """
        axes = camera.axes
        direction = parameter("direction", self.direction, (3,), axes.dtype, axes.device, shared=True).reshape(-1, 3)
        batch_size(direction=len(direction), camera=len(axes))
        right, up, forward = (direction[..., None] * axes).unbind(1)
        return Light(self.ambient, self.directional, direction=right + up - forward)


def pixel_lights(lights: Sequence[Any]) -> None:
    """Raise TypeError unless all lights have a method of `Beam` or `Ambience`."""
    for light in lights:
        if not isinstance(light, (Beam, Ambience)) or isinstance(light, type):
            raise TypeError(
                f"light: {_kind(light)} lights whole faces only (its method two_sided); per-pixel "
                f'pixels needs a method beam or ambience; shading="flat" draws it'
            )


def _kind(light: Any) -> str:
    return "type" if isinstance(light, type) else type(light).__name__


def checked_lights(light: Any, flat: bool) -> list[Any]:
    """Return the argument ``light`` of `render` as a list; TypeError, ValueError: a light does not fit the shading.

    ``flat``: flat shading; otherwise per-pixel shading.
    """
    lights = list(light) if isinstance(light, (list, tuple)) else [] if light is None else [light]
    for one in lights:
        kind = _kind(one)
        if not isinstance(one, (CameraLight, Light, FaceLight, Beam, Ambience)) or isinstance(one, type):
            raise TypeError(
                f"light: expected a Light, PointLight, …, a list of them or None, got {kind}, without a method beam, "
                f"ambience or two_sided"
            )
        if flat and not isinstance(one, (CameraLight, Light, FaceLight)):
            raise TypeError(
                f'light: expected a method two_sided for shading="flat", got {kind}; shading="smooth" draws it'
            )
    if light is not None and not lights:
        raise ValueError("light: expected at least one, got an empty list; None renders textures without light")
    if not flat:
        pixel_lights([one for one in lights if not isinstance(one, CameraLight)])
    return lights


def seen_by(camera: Camera, light: CameraLight) -> Light:
    """Return ``light.at(camera)``, kept while both are constants."""
    parts = (camera.rotation, camera.K, light.ambient, light.directional, light.direction)
    options = light, validate.values_are_checked(camera.rotation)
    return kept_with(camera, "light", parts, camera.rotation.device, lambda: light.at(camera), *options)


def _constant_parameters(light: Light, points: Tensor, batch: int) -> tuple[Tensor, Tensor, Tensor]:
    parts = (light.ambient, light.directional, light.ambient_color, light.directional_color, light.direction)
    options = batch, validate.values_are_checked(points)
    make = partial(light._parameters, points.dtype, points.device, batch)
    return kept_with(light, "parameters", parts, points.device, make, *options)


def light_factors(lights: Sequence[FaceLight], vertices: Tensor, faces: Tensor, images: int, mirrored: bool) -> Tensor:
    """Add up the light on both sides of faces, as `Light.two_sided`; with first derivatives only.

    Vertices [V, 3] or [B, V, 3] floating are finite, in world space; faces are indices in range, int32 or int64.
    """
    points = vertices if vertices.dim() == 3 else vertices[None]
    is_simple = points.dtype == torch.float32 and is_eager((points,))
    corners: Tensor | None = None
    several = []
    for light in lights:
        if is_simple and isinstance(light, Light) and type(light) is Light and not light._is_ambient:
            indices = corner_indices(points, faces, images, in_range=True)
            batch = max(len(points), len(indices))
            ambient, directional, direction = _constant_parameters(light, points, batch)
            several.append(flat_light(points, indices, ambient, directional, direction, mirrored))
        else:
            corners = world_corners(vertices, faces, images, in_range=True) if corners is None else corners
            several.append(light.two_sided(corners, mirrored))
    # Light for all images broadcasts to light for each.
    return several[0] if len(several) == 1 else torch.stack(torch.broadcast_tensors(*several)).sum(0)


def without_unlit(light: Tensor, mesh: Any) -> Tensor:
    """Set the light [B or 1, 2, F, 3] on faces to 1 where their material is unlit (KHR_materials_unlit)."""
    if not isinstance(mesh, UVMesh) or not any(material.unlit for material in mesh.materials):
        return light
    if mesh.material_index is None:
        return torch.ones_like(light)
    flags = torch.tensor([*(material.unlit for material in mesh.materials), False], device=light.device)
    return torch.where(flags[mesh.material_index.long()].reshape(-1, 1, mesh.num_faces, 1), 1.0, light)
