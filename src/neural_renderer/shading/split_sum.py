"""The split sum: reflection of environment light as a table (Karis, "Real Shading in Unreal Engine 4", 2013)."""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn import functional

from ..base.constants import on_device
from ..textures.sample_texture import sampled
from .pixels.planes import planar

_SIZE = 32  # entries along each axis of the table
_STEPS = (64, 16)  # samples of polar angle and azimuth for each entry


def split_sum(cosine: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Integrate the reflection of uniform light over the hemisphere, by a bilinear table.

    Returns scale, bias and fresnel. A surface of reflectance f0 reflects f0 · scale + bias of the light, and transmits
    (1 − f0) (1 − fresnel) into its diffuse part; fresnel is the mean of (1 − v · h)⁵ over the incident light.

    They are [B, H, W, 1] each, and differentiable in the cosine n · v in (0, 1], [B, H, W, 1] float32, and the
    perceptual roughness in [0, 1], which broadcasts to it.
    """
    table = on_device(_table(), cosine)
    # √cosine makes the table finer at grazing angles, where it changes most. Row 0 is roughness 0.
    x, y = torch.broadcast_tensors(cosine.sqrt(), roughness.clamp(0, 1))
    texel = (torch.cat((x, y), -1) * (_SIZE - 1) + 0.5) / _SIZE
    uv = torch.stack((texel[..., 0], 1 - texel[..., 1]), -1)
    scale, bias, fresnel = planar(sampled(table, uv, None, "clamp")).split(1, -1)
    return scale, bias, fresnel


@functools.lru_cache(maxsize=1)
def _table() -> Tensor:
    """Compute scale, bias and fresnel, [1, roughness, √cosine, 3] float32."""
    with torch.inference_mode(False), torch.no_grad():
        axis = torch.linspace(0, 1, _SIZE, dtype=torch.float64)
        alpha, cosine = axis.clamp(min=0.03)[:, None, None] ** 2, axis.clamp(min=0.01)[:, None] ** 2
        v = torch.stack(((1 - cosine**2).sqrt(), torch.zeros_like(cosine), cosine), -1)
        # Steps are shorter for halfway vectors far from the normal, which reflect light at grazing angles.
        step = (torch.arange(_STEPS[0], dtype=torch.float64) + 0.5) / _STEPS[0]
        step = step.repeat_interleave(_STEPS[1])
        azimuth = (torch.arange(_STEPS[1], dtype=torch.float64) + 0.5) * (math.pi / _STEPS[1])
        azimuth, uniform, jacobian = azimuth.repeat(_STEPS[0]), 1 - (1 - step) ** 4, 4 * (1 - step) ** 3 / len(step)
        h = _half_vectors(uniform, azimuth, alpha)
        vh = (v * h).sum(-1).clamp(min=0)
        nl = (2 * vh * h[..., 2] - cosine).clamp(min=0)
        # Importance sampling: the weight is D V (n · l) over the density D (n · h) / (4 v · h).
        visible = 1 / ((nl + _root(alpha**2, nl)) * (cosine + _root(alpha**2, cosine)))
        weight = jacobian * visible * nl * 4 * vh / h[..., 2].clamp(min=1e-6)
        grazing = (1 - vh) ** 5
        # For α = 1, GGX has the density (n · h) / π of cosine-weighted directions, so h also serves as a light
        # direction.
        towards = _half_vectors(uniform, azimuth, 1.0)
        between = functional.normalize(towards + v, dim=-1)
        fresnel = (jacobian * (1 - (v * between).sum(-1).clamp(0, 1)) ** 5).sum(-1).expand(_SIZE, _SIZE)
        parts = ((weight * (1 - grazing)).sum(-1), (weight * grazing).sum(-1), fresnel)
        return torch.stack(parts, -1)[None].float()


def _root(square: Tensor, cosine: Tensor) -> Tensor:
    return (square + (1 - square) * cosine**2).sqrt()


def _half_vectors(uniform: Tensor, azimuth: Tensor, alpha: Tensor | float) -> Tensor:
    """Map numbers in [0, 1) and angles to unit halfway vectors [..., 3] about the z axis, with GGX's density."""
    rest = 1 - uniform
    cosine = (rest / (rest + alpha**2 * uniform)).sqrt()
    sine = (1 - cosine**2).clamp(min=0).sqrt()
    return torch.stack(torch.broadcast_tensors(sine * azimuth.cos(), sine * azimuth.sin(), cosine), -1)
