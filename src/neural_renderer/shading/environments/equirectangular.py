"""Equirectangular images: directions as longitude and latitude."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ...textures.sample_texture import sampled

# How far the columns of other programs' images are from ours, to the right, in widths of the image. Their middle column
# is +z in Mitsuba (its plug-in "envmap"), where u = atan2(x, -z) / 2 pi. It is +x in three.js and Khronos' glTF viewer,
# where u = 1/2 + atan2(z, x) / 2 pi, and in Blender, whose u = 1/2 - atan2(y, x) / 2 pi is the same after its export to
# glTF with y up.
CONVENTIONS = {"neural_renderer": 0.0, "mitsuba": 0.5, "blender": 0.25, "gltf": 0.25}

_POLE = 1e-12  # squared distance from the poles, in units of the radius, below which longitude has no gradient


def from_convention(image: Tensor, convention: str) -> Tensor:
    """Roll an image [..., H, W, C] of another program so that its middle column is −z; raise ValueError otherwise."""
    if convention not in CONVENTIONS:
        raise ValueError(f"convention: expected one of {', '.join(CONVENTIONS)}, got {convention!r}")
    shift, width = CONVENTIONS[convention] * image.shape[-2], image.shape[-2]
    if shift % 1:
        raise ValueError(f"image: expected a width that 4 divides for convention {convention!r}, got {width} columns")
    return image.roll(int(shift), -2) if shift else image


def direction_uv(directions: Tensor) -> Tensor:
    """Convert directions [..., 3] to uv [..., 2] in [0, 1] of an equirectangular image, v up; differentiable.

    Row 0 is up, +y. The middle column is −z, columns to its right are towards +x.
    """
    x, y, z = directions.unbind(-1)
    across = x * x + z * z
    z = torch.where(across < _POLE, torch.full_like(z, -1.0), z)
    u = 0.5 + torch.atan2(x, -z) / (2 * math.pi)
    return torch.stack((u, 0.5 + torch.atan2(y, across.clamp(min=_POLE).sqrt()) / math.pi), -1)


def directions_of(height: int, width: int, like: Tensor) -> Tensor:
    """Compute the directions of the pixels of an equirectangular image, [H, W, 3] unit vectors."""
    row = (torch.arange(height, dtype=like.dtype, device=like.device) + 0.5) * (math.pi / height)
    azimuth = (torch.arange(width, dtype=like.dtype, device=like.device) + 0.5) * (2 * math.pi / width) - math.pi
    polar, azimuth = row[:, None].expand(height, width), azimuth.expand(height, width)
    return torch.stack((polar.sin() * azimuth.sin(), polar.cos(), -polar.sin() * azimuth.cos()), -1)


def solid_angles(height: int, width: int, like: Tensor) -> Tensor:
    """Compute the solid angle of a pixel of each row, [H]; all pixels together cover 4π."""
    edges = torch.cos(torch.arange(height + 1, dtype=like.dtype, device=like.device) * (math.pi / height))
    return (edges[:-1] - edges[1:]) * (2 * math.pi / width)


def look_up(image: Tensor, uv: Tensor) -> Tensor:
    """Sample images [1 or B, H, W, C] at [B, h, w, 2] bilinearly: columns repeat, rows do not."""
    return sampled(image, uv, None, ("repeat", "clamp"))
