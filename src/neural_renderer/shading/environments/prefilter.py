"""Blurred reflections of an environment: mipmaps prefiltered for roughness.

Level k holds, for each direction r, the mean of the light l weighted by D (r · h) max(r · l, 0), the GGX lobe of
roughness k / LEVELS at normal incidence, h halfway between r and l (Karis, "Real Shading in Unreal Engine 4", 2013).
Wide lobes are summed over all pixels of a small image. Narrow lobes are importance-sampled by halfway vectors; each
sample reads a mipmap level with texels as large as its solid angle, so that few samples suffice (Křivánek and Colbert,
"Real-time Shading with Filtered Importance Sampling", 2008).
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn import functional

from ...base.constants import on_device
from ...raster.colors.mipmaps import halved
from ..pixels.planes import planar
from .equirectangular import direction_uv, directions_of, look_up, solid_angles

LEVELS = 8
_ROWS = 128  # most rows of a level
_FEWEST = 16  # rows of the roughest levels
_WIDE = 0.2  # α of lobes that are summed over all pixels
_SMALL = 48  # most rows of the image that wide lobes sum over
_SAMPLES = 128
_SHARPER = 0.5  # bias of the mipmap level towards sharper ones, because neighbouring samples overlap


def prefiltered(image: Tensor) -> Tensor:
    """Blur linear equirectangular images [B, H, W, 3] float32 for reflections of each roughness.

    Returns [B, LEVELS · h, w, 3]: levels of roughness 1 / LEVELS to 1, one below the other. Linear in the image.
    """
    height, width = image.shape[1:3]
    rows = min(height, _ROWS)
    columns = max(1, rows * width // height)
    mipmaps = _mipmaps(image)
    levels = []
    for level in range(1, LEVELS + 1):
        alpha = (level / LEVELS) ** 2
        if alpha >= _WIDE:
            blurred = _summed(mipmaps, alpha)
        else:
            # Texels about as wide as the reflection lobe.
            level_rows = min(rows, 2 ** math.ceil(math.log2(math.pi / alpha)))
            blurred = _sampled(mipmaps, alpha, level_rows, max(1, level_rows * width // height))
        if blurred.shape[1:3] != (rows, columns):
            uv = direction_uv(directions_of(rows, columns, image))
            blurred = look_up(blurred, uv.expand(len(image), -1, -1, -1))
        levels.append(blurred)
    return torch.cat(levels, 1)


def reflected(image: Tensor, levels: Tensor, directions: Tensor, roughness: Tensor) -> Tensor:
    """Look up blurred reflections, linear between levels: [B, h, w, 3], differentiable in all arguments.

    Roughness is [B, h, w, 1], directions of reflection [B, h, w, 3]; roughness 0 shows the image, [1 or B, H, W, 3].
    """
    uv = direction_uv(directions)
    place = roughness.clamp(0, 1) * LEVELS
    lower = place.detach().floor().clamp(max=LEVELS - 1)
    part = place - lower
    below = planar(torch.where(lower == 0, look_up(image, uv), _level(levels, uv, (lower - 1).clamp(min=0))))
    return below + part * (planar(_level(levels, uv, lower)) - below)


def _level(levels: Tensor, uv: Tensor, number: Tensor) -> Tensor:
    """Sample one level for each pixel, with its number [B, h, w, 1], without reading the next one."""
    rows = levels.shape[1] // LEVELS
    from_top = (1 - uv[..., 1:]).clamp(0.5 / rows, 1 - 0.5 / rows)
    return look_up(levels, torch.cat((uv[..., :1], 1 - (number + from_top) / LEVELS), -1))


def _mipmaps(image: Tensor) -> list[Tensor]:
    """Halve an image [B, H, W, 3] down to about four rows."""
    mipmaps = [image]
    while min(image.shape[1:3]) >= 8:
        image = halved(image.movedim(-1, 1)).movedim(1, -1).contiguous()
        mipmaps.append(image)
    return mipmaps


def _summed(mipmaps: list[Tensor], alpha: float) -> Tensor:
    """Average the light over the lobe about each direction, over all pixels; [B, 16, 32, 3]."""
    image = next((mipmap for mipmap in mipmaps if mipmap.shape[1] <= _SMALL), mipmaps[-1])
    weights = on_device(_weights(alpha, *image.shape[1:3]), image)
    # Not matmul: it rounds under autocast, and its order of summation depends on the batch.
    light = image.flatten(1, 2).transpose(1, 2)
    parts = [(light[:, None] * part[:, None]).sum(-1) for part in weights.split(64)]
    return torch.cat(parts, 1).view(len(image), _FEWEST, 2 * _FEWEST, 3)


@functools.lru_cache(maxsize=16)
def _weights(alpha: float, height: int, width: int) -> Tensor:
    """Compute the weight of each pixel of an image for each direction of a level, [16 · 32, H · W]."""
    with torch.inference_mode(False), torch.no_grad():
        like = torch.zeros((), dtype=torch.float64)
        light = directions_of(height, width, like).view(-1, 3)
        cosine = directions_of(_FEWEST, 2 * _FEWEST, like).view(-1, 3) @ light.T
        lobe = cosine.clamp(min=0) / ((1 + cosine) / 2 * (alpha**2 - 1) + 1) ** 2
        weights = lobe * solid_angles(height, width, like).repeat_interleave(width)
        return (weights / weights.sum(1, keepdim=True)).float()


def _sampled(mipmaps: list[Tensor], alpha: float, rows: int, columns: int) -> Tensor:
    """Average the light over the lobe about each direction, over samples; [B, rows, columns, 3]."""
    batch, height, width, _ = mipmaps[0].shape
    levels: dict[int, list[tuple[float, ...]]] = {}
    for direction, weight, share in _lobe_samples(alpha):
        # The mipmap level whose texels are as large as the solid angle of a sample.
        level = round(0.5 * math.log2(share * height * width / (4 * math.pi)) - _SHARPER)
        levels.setdefault(min(max(level, 0), len(mipmaps) - 1), []).append((*direction, weight))
    axis = directions_of(rows, columns, mipmaps[0])
    pole = torch.where(axis[..., 1:2].abs() < 0.9, axis.new_tensor([0.0, 1.0, 0.0]), axis.new_tensor([1.0, 0.0, 0.0]))
    right = functional.normalize(torch.linalg.cross(pole, axis, dim=-1), dim=-1)
    frame = torch.stack((right, torch.linalg.cross(axis, right, dim=-1), axis), -2)
    result = mipmaps[0].new_zeros(batch, rows, columns, 3)
    for level, samples in levels.items():
        for few in (samples[k : k + 8] for k in range(0, len(samples), 8)):
            values = torch.tensor(few, dtype=frame.dtype, device=frame.device)[:, None, None]
            directions = (values[..., :3, None] * frame).sum(-2)  # [samples, rows, columns, 3]
            uv = direction_uv(directions).flatten(0, 1)[None].expand(batch, -1, -1, -1)
            light = look_up(mipmaps[level], uv).view(batch, len(few), rows, columns, 3)
            result = result + (light * values[..., 3:]).sum(1)
    return result


def _lobe_samples(alpha: float) -> list[tuple[tuple[float, float, float], float, float]]:
    """List sample directions about the z axis, with weights that sum to 1, and their solid angles."""
    samples = []
    for index in range(_SAMPLES):
        uniform, azimuth = (index + 0.5) / _SAMPLES, index * math.pi * (1 + 5**0.5)  # multiples of the golden angle
        square = (1 - uniform) / (1 - uniform + alpha**2 * uniform)  # z² of the halfway vector
        z, across = math.sqrt(square), math.sqrt(1 - square)
        density = alpha**2 / (math.pi * (square * (alpha**2 - 1) + 1) ** 2) / 4
        direction = (2 * z * across * math.cos(azimuth), 2 * z * across * math.sin(azimuth), 2 * square - 1)
        samples.append((direction, max(direction[2], 0.0), 1 / (_SAMPLES * density)))
    whole = sum(weight for _, weight, _ in samples)
    return [(direction, weight / whole, angle) for direction, weight, angle in samples if weight > 0]
