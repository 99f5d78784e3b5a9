"""Matt surfaces, and highlights after Phong and Blinn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..camera.parameters import Array, Scalar, parameter
from .lights import Ambience, Beam, pixel_lights
from .pixels.planes import dot, planar, tinted, unit
from .pixels.visible_surface import VisibleSurface


def shade_diffuse(surface: VisibleSurface, albedo: Tensor, lights: Sequence[Any]) -> Tensor:
    """Shade a matt surface: albedo · (ambient light + Σ light · max(n · l, 0)), Lambert's law.

    Args:
        surface: The visible surface, from `VisibleSurface.of`.
        albedo: RGB of the surface, [B, H, W, 3] floating.
        lights: Lights that add up; without any, the albedo is returned unchanged.

    Returns:
        [B, H, W, 3], differentiable in all arguments.

    Raises:
        TypeError, ValueError: A light lights whole faces only, or a parameter does not fit.

    Example:
        >>> fragments = nr.fragments(mesh, camera, 64)
        >>> surface = nr.VisibleSurface.of(fragments, mesh, camera)
        >>> colors = nr.shade_diffuse(surface, torch.ones_like(surface.points), [nr.Light()])
        >>> image = fragments.composite(colors)
    """
    pixel_lights(lights)
    if not lights:
        return albedo
    parts = [light.ambience(surface.normals) for light in lights if isinstance(light, Ambience)]
    for light in lights:
        if isinstance(light, Beam):
            towards, rgb = light.beam(surface.points)
            parts.append(tinted(torch.relu(dot(surface.normals, towards)), rgb))
    return planar(albedo) * total(parts)


def shade_phong(
    surface: VisibleSurface,
    albedo: Tensor,
    lights: Sequence[Any],
    specular: Tensor | float,
    shininess: Tensor | float,
    halfway: bool = False,
) -> Tensor:
    """Shade a glossy surface: `shade_diffuse` plus Σ specular · light · max(v · r, 0)^shininess.

    r is the direction towards the light mirrored at the normal, v the direction to the eye (Phong, "Illumination for
    Computer Generated Pictures", 1975). With ``halfway`` the highlight is max(n · h, 0)^shininess instead, h halfway
    between light and eye (Blinn, "Models of Light Reflection for Computer Synthesized Pictures", 1977); at equal
    sharpness its shininess is about four times as large. Ambient light gives no highlight; `shade_pbr` reflects it.

    Args:
        surface: The visible surface, from `VisibleSurface.of`.
        albedo: RGB of the surface, [B, H, W, 3] floating.
        lights: Lights that add up; without any there are no highlights.
        specular: Strength of highlights: number, or [B, H, W, 3] or what broadcasts to it.
        shininess: Exponent, ≥ 0; larger is sharper: number, or [B, H, W, 1] or what broadcasts to it.
        halfway: Use Blinn's halfway vector in place of the reflected light.

    Returns:
        [B, H, W, 3], differentiable in all floating arguments.

    Raises:
        TypeError, ValueError: As `shade_diffuse`.

    Example:
        >>> fragments = nr.fragments(mesh, camera, 64)
        >>> surface = nr.VisibleSurface.of(fragments, mesh, camera)
        >>> white = torch.ones_like(surface.points)
        >>> image = fragments.composite(nr.shade_phong(surface, white, [nr.Light()], 0.5, 32.0))
    """
    colors = shade_diffuse(surface, albedo, lights)
    halfway = validate.flag("halfway", halfway)
    for light in lights:
        if isinstance(light, Beam):
            towards, rgb = light.beam(surface.points)
            facing = dot(surface.normals, towards)
            if halfway:
                cosine = dot(surface.normals, unit(towards + surface.views))
            else:
                cosine = dot(surface.views, 2 * facing * surface.normals - towards)
            # No highlight where the surface faces away from the light.
            shine = (torch.relu(cosine) * (facing > 0)) ** shininess
            colors = colors + tinted(shine, rgb) * specular
    return colors


class Reflection:
    """Base of reflection models with one set of parameters for the mesh: `Phong` and `PBR`."""

    def shade(self, surface: VisibleSurface, albedo: Tensor, lights: Sequence[Any]) -> Tensor:
        """Compute the colours of pixels.

        Args:
            surface: The visible surface.
            albedo: RGB of the surface, display values (sRGB), [B, H, W, 3] floating.
            lights: Lights that add up; without any there are no highlights.

        Returns:
            Display values [B, H, W, 3], differentiable in all arguments and parameters.

        Raises:
            TypeError, ValueError: As `shade_phong` and `shade_pbr`.

        Example:
            >>> surface = nr.VisibleSurface.of(nr.fragments(mesh, camera, 64), mesh, camera)
            >>> colors = nr.Phong().shade(surface, torch.ones_like(surface.points), [nr.PointLight((0.0, 2.0, -2.0))])
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Phong(Reflection):
    """Highlights of glossy surfaces, for ``shading`` of `render` and meshes without materials; see `shade_phong`.

    Attributes:
        specular: Strength of highlights: number, or RGB [3] or [B, 3].
        shininess: Exponent, ≥ 0; larger is sharper: number, or tensor [] or [B].
        halfway: Use Blinn's halfway vector in place of the reflected light.

    Raises:
        TypeError, ValueError: Raised by `render`: a parameter does not fit.

    Example:
        >>> images = nr.render(mesh, camera, 64, shading=nr.Phong(0.4, shininess=50))
    """

    specular: Array | Scalar = 0.5
    shininess: Scalar = 32.0
    halfway: bool = False

    def shade(self, surface: VisibleSurface, albedo: Tensor, lights: Sequence[Any]) -> Tensor:
        is_number = isinstance(self.specular, (int, float)) or getattr(self.specular, "ndim", 1) == 0
        specular = of_images("specular", self.specular, 1 if is_number else 3, surface.points)
        shininess = of_images("shininess", self.shininess, 1, surface.points)
        if validate.values_are_checked(shininess) and bool((shininess < 0).any()):
            raise ValueError(f"shininess: expected at least 0, got {self.shininess}")
        return shade_phong(surface, albedo, lights, specular, shininess, self.halfway)


def total(parts: Sequence[Tensor]) -> Tensor:
    """Add tensors that broadcast."""
    result = parts[0]
    for part in parts[1:]:
        result = result + part
    return result


def of_images(name: str, value: Any, channels: int, points: Tensor) -> Tensor:
    """Convert a number, [] or [B], or with three channels RGB, [3] or [B, 3], to [1 or B, 1, 1, channels].

    The result has the dtype and device of points [B, H, W, 3]. TypeError, ValueError: The value does not fit.
    """
    found = parameter(name, value, (3,) if channels == 3 else (), points.dtype, points.device, shared=True)
    found = found.reshape(-1, 1, 1, channels)
    if len(found) not in (1, len(points)):
        raise ValueError(f"{name}: expected a batch of 1 or {len(points)} like the images, got {len(found)}")
    return found
