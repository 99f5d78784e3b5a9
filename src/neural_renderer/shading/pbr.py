"""Physically based reflection: metals and dielectrics of any roughness, as in glTF 2.0 (appendix B).

A microfacet surface (Cook and Torrance, "A Reflectance Model for Computer Graphics", 1982) reflects
f = (1 − F) c / π + F D V, with these terms for light direction l, eye v, h halfway between them and α = roughness²:

- D = α² / (π ((n · h)² (α² − 1) + 1)²), the GGX distribution of slopes (Walter et al., "Microfacet Models for
  Refraction through Rough Surfaces", 2007);
- V = G / (4 (n · l) (n · v)), Smith's masking of both directions (Heitz, "Understanding the Masking-Shadowing Function
  in Microfacet-Based BRDFs", 2014), in the separable form;
- F = f0 + (1 − f0) (1 − v · h)⁵ (Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", 1994);
- c = (1 − metallic) · base colour and f0 = 0.04 of dielectrics, base colour of metals.

All colours are linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..base.color_space import linear_to_srgb, srgb_to_linear
from ..camera.parameters import Scalar
from .lights import Ambience, Beam, pixel_lights
from .phong import Reflection, of_images, total
from .pixels.planes import dot, planar, unit
from .pixels.visible_surface import VisibleSurface
from .split_sum import split_sum

DIELECTRIC = 0.04  # reflectance of plastics and glass (index of refraction 1.5) at normal incidence
SMOOTHEST = 0.03  # least roughness of highlights: float32 cannot represent sharper ones
_GRAZING = 1e-4  # least cosine between normal and eye; interpolated normals may point away from the eye


def shade_pbr(
    surface: VisibleSurface,
    base_color: Tensor,
    metallic: Tensor | float,
    roughness: Tensor | float,
    lights: Sequence[Any],
    occlusion: Tensor | float = 1.0,
    emissive: Tensor | float = 0.0,
) -> Tensor:
    """Shade a surface by the metallic-roughness model of glTF 2.0.

    Args:
        surface: The visible surface, from `VisibleSurface.of`.
        base_color: **Linear** RGB, [B, H, W, 3] or what broadcasts to it.
        metallic: In [0, 1]: number, or [B, H, W, 1] or what broadcasts to it.
        roughness: Perceptual roughness in [0, 1], in the same forms; α = roughness². Below 0.03 it counts as 0.03.
        lights: Lights that add up. A light of strength 1 from the front shows a white matt surface as 1.
        occlusion: Fraction of ambient light that reaches the surface, in the same forms; direct light is not occluded.
        emissive: **Linear** RGB that the surface emits.

    Returns:
        **Linear** radiance [B, H, W, 3], ≥ 0, without an upper limit; differentiable in all arguments.
        `linear_to_srgb` converts it to display values.

    Raises:
        TypeError, ValueError: A light lights whole faces only, or a parameter does not fit.

    Example:
        >>> fragments = nr.fragments(mesh, camera, 64)
        >>> surface = nr.VisibleSurface.of(fragments, mesh, camera)
        >>> gold = torch.tensor([1.0, 0.77, 0.34])
        >>> radiance = nr.shade_pbr(surface, gold, 1.0, 0.3, [nr.Light(), nr.PointLight((1.0, 2.0, -2.0), 5.0)])
        >>> image = fragments.composite(nr.linear_to_srgb(radiance))
    """
    pixel_lights(lights)
    # Convert to tensors, so that the parameters broadcast in any combination.
    metallic, roughness = (torch.as_tensor(value, **_like(surface)) for value in (metallic, roughness))
    n, v = surface.normals, surface.views
    base_color = planar(base_color.expand(n.shape))
    matt = (1 - metallic) * base_color
    f0 = DIELECTRIC + (base_color - DIELECTRIC) * metallic
    nv = dot(n, v).clamp(_GRAZING, 1)
    parts = [torch.as_tensor(emissive, **_like(surface)).expand_as(n)]
    for light in lights:
        if isinstance(light, Beam):
            towards, rgb = light.beam(surface.points)
            alpha = roughness.clamp(min=SMOOTHEST) ** 2
            parts.append(_reflected(n, v, towards, nv, matt, f0, alpha) * rgb)
    ambient = [light for light in lights if isinstance(light, Ambience)]
    if ambient:
        scale, bias, fresnel = split_sum(nv, roughness)
        glossy = f0 * scale + bias
        transmitted = matt * (1 - f0) * (1 - fresnel)
        mirrored = _lobe(n, 2 * dot(n, v) * n - v, roughness)
        even = roughness.expand_as(nv)
        for light in ambient:
            parts.append(occlusion * (transmitted * light.ambience(n) + glossy * light.ambience(mirrored, even)))
    return total(parts)


@dataclass(frozen=True, eq=False)
class PBR(Reflection):
    """Metals and dielectrics, for ``shading`` of `render` and meshes without materials.

    The colours of the mesh are the base colours. They are display values: they are converted from sRGB to linear light,
    shaded by `shade_pbr`, and converted back pixel by pixel. There is no tone mapping.

    Attributes:
        metallic: 0 for plastic, wood, stone; 1 for metals: number, or tensor [] or [B].
        roughness: 0 for a mirror, 1 for matt: number, or tensor [] or [B].

    Raises:
        TypeError, ValueError: Raised by `render`: a parameter does not fit.

    Example:
        >>> images = nr.render(mesh, camera, 64, shading=nr.PBR(metallic=1.0, roughness=0.3))
    """

    metallic: Scalar = 0.0
    roughness: Scalar = 0.5

    def shade(self, surface: VisibleSurface, albedo: Tensor, lights: Sequence[Any]) -> Tensor:
        if not lights:
            return albedo
        metallic = of_images("metallic", self.metallic, 1, surface.points)
        roughness = of_images("roughness", self.roughness, 1, surface.points)
        return linear_to_srgb(shade_pbr(surface, srgb_to_linear(albedo), metallic, roughness, lights))


def _like(surface: VisibleSurface) -> dict[str, Any]:
    return {"dtype": surface.points.dtype, "device": surface.points.device}


def _reflected(n: Tensor, v: Tensor, towards: Tensor, nv: Tensor, matt: Tensor, f0: Tensor, alpha: Tensor) -> Tensor:
    """Evaluate π f(l, v) (n · l): reflected light, relative to a white Lambertian surface that faces the light."""
    nl = torch.relu(dot(n, towards))
    h = unit(towards + v)
    square = alpha * alpha
    # With (n · h)² = 1 − s, (n · h)² (α² − 1) + 1 = α² + s (1 − α²). Computed from n − h, s is accurate for sharp
    # highlights, too.
    apart = dot(n - h, n - h) / 2
    spread = square / (square + apart * (2 - apart) * (1 - square)) ** 2
    masked = _smith(nl, square) * _smith(nv, square)
    fresnel = schlick(f0, dot(v, h))
    return ((1 - fresnel) * matt + fresnel * (spread * masked)) * nl


def _lobe(n: Tensor, mirrored: Tensor, roughness: Tensor) -> Tensor:
    """Move the direction of reflection towards the normal, as masking moves the lobe of rough surfaces.

    After Lagarde and de Rousiers, "Moving Frostbite to Physically Based Rendering", 2014, section 4.9.
    """
    smooth = (1 - roughness * roughness).clamp(min=1e-6)
    return unit(n + (mirrored - n) * (smooth * (smooth.sqrt() + 1 - smooth)))


def _smith(cosine: Tensor, square: Tensor) -> Tensor:
    """Compute Smith's masking of one direction, divided by twice its cosine."""
    return 1 / (cosine + (square + (1 - square) * cosine * cosine).sqrt())


def schlick(f0: Tensor, cosine: Tensor) -> Tensor:
    """Compute Schlick's approximation of Fresnel's reflectance."""
    return f0 + (1 - f0) * (1 - cosine.clamp(0, 1)) ** 5
