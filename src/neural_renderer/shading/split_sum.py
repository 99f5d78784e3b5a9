"""The split sum: reflection of light from all around as a table (Karis, "Real Shading in Unreal Engine 4", 2013)."""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn import functional

from ..constants import on_device
from ..textures.sample_texture import sampled

_SIZE = 32  # entries along each axis of the table
_SAMPLES = 1024  # halfway vectors of each entry


def split_sum(cosine: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Integrate the reflection of uniform light over the hemisphere.

    A surface of reflectance f0 reflects f0 · scale + bias of it, and transmits (1 − f0) (1 − fresnel) into its matt
    part. fresnel is the mean of (1 − v · h)⁵ over the light that falls on the surface.

    Args:
        cosine: n · v in (0, 1], [B, H, W, 1] float32.
        roughness: Perceptual roughness in [0, 1], [B, H, W, 1] or what broadcasts to it.

    Returns:
        scale, bias and fresnel, [B, H, W, 1] each, bilinear in a table; differentiable.
    """
    table = on_device(_table(), cosine)
    # The table is finer at grazing angles, where it changes most. Its row 0 is roughness 0.
    x, y = torch.broadcast_tensors(cosine.sqrt(), roughness.clamp(0, 1))
    place = (torch.cat((x, y), -1) * (_SIZE - 1) + 0.5) / _SIZE
    uv = torch.stack((place[..., 0], 1 - place[..., 1]), -1)
    scale, bias, fresnel = sampled(table, uv, None, "clamp").split(1, -1)
    return scale, bias, fresnel


def half_vectors(count: int, alpha: Tensor) -> Tensor:
    """Spread halfway vectors about the z axis with the density D (n · h) of GGX, [..., count, 3] float64.

    Args:
        count: Number of vectors, of Hammersley's points.
        alpha: [...] float64, > 0.
    """
    index = torch.arange(count, dtype=torch.int64)
    reversed_bits = sum(((index >> bit) & 1).double() / 2 ** (bit + 1) for bit in range(max(1, count.bit_length())))
    uniform = (index.double() + 0.5) / count
    cosine = ((1 - uniform) / (1 + (alpha[..., None] ** 2 - 1) * uniform)).sqrt()
    sine = (1 - cosine**2).clamp(min=0).sqrt()
    turn = (2 * math.pi * reversed_bits).expand_as(cosine)
    return torch.stack((sine * turn.cos(), sine * turn.sin(), cosine), -1)


@functools.lru_cache(maxsize=1)
def _table() -> Tensor:
    """Compute scale, bias and fresnel, [1, roughness, √cosine, 3] float32."""
    with torch.inference_mode(False), torch.no_grad():
        axis = torch.linspace(0, 1, _SIZE, dtype=torch.float64)
        roughness, cosine = axis.clamp(min=0.03)[:, None], axis.clamp(min=0.01)[None] ** 2
        alpha = (roughness**2).expand(_SIZE, _SIZE)
        v = torch.stack(torch.broadcast_tensors((1 - cosine**2).sqrt(), torch.zeros_like(cosine), cosine), -1)
        h = half_vectors(_SAMPLES, alpha)
        vh = (v[..., None, :] * h).sum(-1).clamp(min=0)
        nl = 2 * vh * h[..., 2] - v[..., None, 2]
        nl = nl.clamp(min=0)
        # A sample weighs D V (n · l) / density of l, where the density is D (n · h) / (4 v · h).
        square = alpha[..., None] ** 2
        visible = 1 / ((nl + _root(square, nl)) * (v[..., None, 2] + _root(square, v[..., None, 2])))
        weight = visible * nl * 4 * vh / h[..., 2].clamp(min=1e-6)
        grazing = (1 - vh) ** 5
        scale, bias = (weight * (1 - grazing)).mean(-1), (weight * grazing).mean(-1)
        fresnel = _matt_fresnel(v[0]).expand(_SIZE, _SIZE)
        return torch.stack((scale, bias, fresnel), -1)[None].float()


def _matt_fresnel(v: Tensor) -> Tensor:
    """Average (1 − v · h)⁵ over light l that falls on a surface evenly, for eyes v [N, 3]; [N]."""
    # Of GGX with α = 1 the density of h is (n · h) / π: h serves as l, with Lambert's weights.
    towards = half_vectors(4 * _SAMPLES, torch.ones((), dtype=torch.float64))
    h = functional.normalize(towards + v[:, None], dim=-1)
    return ((1 - (v[:, None] * h).sum(-1).clamp(0, 1)) ** 5).mean(-1)


def _root(square: Tensor, cosine: Tensor) -> Tensor:
    return (square + (1 - square) * cosine**2).sqrt()
