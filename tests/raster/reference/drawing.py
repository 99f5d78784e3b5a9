"""Float64 references of `peel` and `gather_corners`."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from neural_renderer.raster.reference.operators import sides

from .coverage import faces_at_pixels


def peel_reference(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool, layers: int
) -> Tensor:
    """Find the nearest faces of each pixel in order of depth, [layers, B, H, W] int32; see `peel`."""
    result = torch.full((layers, len(faces), height, width), -1, dtype=torch.int32, device=faces.device)
    for b in range(len(faces) if faces.shape[1] else 0):
        found = faces_at_pixels(faces[b], height, width, perspective)
        side = sides(faces[b], perspective)[:, None, None]
        drawn = found.inside & (found.depth < far) & ((side > 0) | two_sided)
        floor = torch.full((height, width), near, dtype=torch.float64, device=faces.device)
        for layer in result[:, b]:
            depth = torch.where(drawn & (found.depth > floor), found.depth.float(), math.inf)
            both = torch.cat((torch.where(side > 0, depth, math.inf), torch.where(side < 0, depth, math.inf)))
            nearest, index = both.min(0)
            layer[:] = torch.where(nearest < math.inf, index % faces.shape[1], -1).int()
            floor = nearest.double() * (1 + 2.0**-17)
    return result


def gather_corners_reference(vertices: Tensor, faces: Tensor) -> Tensor:
    """Gather corners [B, F, 3, 3], differentiable in ``vertices``; NaN for invalid indices; see `gather_corners`."""
    faces = faces.long().expand(len(vertices), *faces.shape[1:])
    valid = ((faces >= 0) & (faces < vertices.shape[1]))[..., None]
    if not vertices.shape[1]:
        return torch.full((*faces.shape, 3), math.nan, dtype=torch.float64)
    image = torch.arange(len(vertices), device=vertices.device)[:, None, None]
    return torch.where(valid, vertices.double()[image, torch.where(valid[..., 0], faces, 0)], math.nan)
