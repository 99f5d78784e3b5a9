"""Conversion of KHR_materials_pbrSpecularGlossiness to the metallic-roughness model of glTF 2.0."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from PIL import Image

from ...surface_colors import linear_to_srgb, srgb_to_linear

_DIELECTRIC = 0.04  # reflectance of dielectrics


class Converted(NamedTuple):
    """A material of the metallic-roughness model; arrays of one pixel stand for factors."""

    base: np.ndarray | None  # [H, W, 3], display values; None where it is the diffuse colour
    metallic_roughness: np.ndarray  # [H, W, 3] float32: 1, roughness, metallic


def converted(
    diffuse: np.ndarray,
    pixels: np.ndarray | None,
    specular: tuple[float, ...],
    glossiness: float,
    *,
    has_specular: bool,
    together: bool,
) -> Converted:
    """Convert a material: the diffuse colour becomes the base colour, and roughness is 1 − glossiness.

    Metallic follows from the brightness of both colours by the quadratic equation in the appendix of the extension. A
    pure metal, whose diffuse colour is black everywhere, gets the specular one as base colour; but in a file
    without a specular colour, which is white by default, it is no mirror. Of textures with metal and other parts, the
    base colours are mixed as in that appendix.

    Args:
        diffuse: [H, W, 3] display values.
        pixels: [H, W, 4] of the texture of specular colour (display values) and glossiness, or None.
        specular: Its factor, linear RGB.
        glossiness: Its factor.
        has_specular: Whether the file has a specular colour.
        together: Whether both textures have the same coordinates; otherwise a mean stands for the diffuse colours.
    """
    specular_texels = np.ones((1, 1, 4), np.float32) if pixels is None else pixels
    shown = linear(diffuse)
    if not together:
        shown = shown.mean((0, 1), keepdims=True)
    height, width = max(shown.shape[:2], specular_texels.shape[:2])
    size = height, width
    shown, specular_texels = _resized(shown, size), _resized(specular_texels, size)
    shine = linear(specular_texels[..., :3]) * np.array(specular)
    metallic = _metallic(shown, shine)
    result = np.ones((*size, 3), np.float32)
    result[..., 1], result[..., 2] = 1 - specular_texels[..., 3] * glossiness, metallic
    if (result == result[0, 0]).all():
        result = result[:1, :1]
    if not has_specular or (shown.any() and (pixels is None or not together or not metallic.any())):
        return Converted(None, result)
    metal = metallic[..., None]
    base = shine * metal
    if shown.any():
        of_metal = (shine - _DIELECTRIC * (1 - metal)) / np.maximum(metal, 1e-6)
        base = (shown + (of_metal - shown) * metal**2).clip(0, 1)
    return Converted(linear_to_srgb(base).astype(np.float32), result)


def linear(colors: np.ndarray) -> np.ndarray:
    """Convert display values to linear light in float64."""
    return srgb_to_linear(colors.astype(np.float64))


def _metallic(diffuse: np.ndarray, specular: np.ndarray) -> np.ndarray:
    """Solve the equation for colours [H, W, 3] of linear light: [H, W]."""
    share = 1 - specular.max(-1)
    light, shine = _brightness(diffuse), _brightness(specular)
    b = light * share / (1 - _DIELECTRIC) + shine - 2 * _DIELECTRIC
    root = np.sqrt(np.maximum(b * b - 4 * _DIELECTRIC * (_DIELECTRIC - shine), 0))
    return np.where(shine < _DIELECTRIC, 0, ((root - b) / (2 * _DIELECTRIC)).clip(0, 1))


def _brightness(colors: np.ndarray) -> np.ndarray:
    """Compute the perceived brightness of colours [..., 3], as the extension does."""
    return np.sqrt((colors**2 * [0.299, 0.587, 0.114]).sum(-1))


def _resized(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Interpolate an image [h, w, C] to a size (H, W)."""
    if pixels.shape[:2] == size:
        return pixels
    if pixels.shape[:2] == (1, 1):
        return np.broadcast_to(pixels, (*size, pixels.shape[2]))
    channels = [
        Image.fromarray(part.astype(np.float32)).resize((size[1], size[0])) for part in np.moveaxis(pixels, 2, 0)
    ]
    return np.stack([np.asarray(channel) for channel in channels], 2)
