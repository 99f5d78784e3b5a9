"""Where colours go on from face to face: a number for each edge, the same on both of its faces if they do."""

from __future__ import annotations

import torch
from torch import Tensor

_STEPS = 4096.0  # of a colour or a factor from 0 to 1: what differs by less is the same
_ODD = 0x9E3779B97F4A7C15 - 2**64  # the golden ratio in 64 bits, whose powers' bits are as good as random


def texture_marks(textures: Tensor, light: Tensor) -> Tensor:
    """Marks [B, F, 3] int64 for `boundaries`, of texture cubes [B, F, T, T, T, 3] and light [B, 2, F, 3].

    Equal for two faces at edge k, from corner k to the next, if the texels that are blended on it are, and their light.
    """
    size, flat = textures.shape[2], textures.detach().flatten(2, 4)
    texel = torch.arange(size**3, device=flat.device).view(size, size, size)
    place = texel[0, 0]
    near = (place[:, None] + place - (size - 1)).abs() <= 1
    sides = torch.stack([side[near] for side in (texel[:, :, 0], texel[0], texel[:, 0])])  # [3, N]
    colors = (flat[:, :, sides.flatten()] * _STEPS).round().to(torch.int32)
    packed = colors[..., 0] + (colors[..., 1] << 10) + (colors[..., 2] << 19)
    # A sum, because the two faces name an edge's texels in opposite orders.
    marks = _mixed(packed.long()).unflatten(2, sides.shape).sum(3)
    return _never_zero(marks + _light_hash(light)[..., None])


def image_marks(vertices: Tensor, faces: Tensor, uv: Tensor, image_index: Tensor, light: Tensor | None) -> Tensor:
    """Likewise [1, F, 3] of texture coordinates [F, 3, 2] on images of that index [F].

    vertices: [V, 3], or of a batch, whose first counts. faces: [F, 3]. Equal if both ends lie at one place, and at one
    place of one image.
    """
    corners = vertices.detach().float().reshape(-1, 3)[faces.long()]
    bits = torch.cat((corners, uv.detach().float()), 2) + 0.0  # or -0 would be another number than 0
    own = _hash(torch.cat((bits.view(torch.int32).long(), image_index[:, None, None].expand(-1, 3, 1)), 2))
    marks = own + own.roll(-1, 1)
    # A face without an image has colours of its own.
    own_colors = torch.arange(len(faces), device=faces.device)[:, None] + 1
    marks = torch.where(image_index[:, None] < 0, _hash(own_colors)[:, None], marks)[None]
    return _never_zero(marks if light is None else marks + _light_hash(light)[..., None])


def _light_hash(light: Tensor) -> Tensor:
    """[B, F] of the factors [B, 2, F, 3] on both sides of each face."""
    return _hash((light.detach().float() * _STEPS).round().long().permute(0, 2, 1, 3).flatten(2))


def _hash(numbers: Tensor) -> Tensor:
    """One int64 for the last dimension's."""
    factors = torch.full((numbers.shape[-1],), _ODD, device=numbers.device).cumprod(0)
    return _mixed((numbers * factors).sum(-1))


def _mixed(number: Tensor) -> Tensor:
    number = (number ^ (number >> 32)) * _ODD
    return number ^ (number >> 29)


def _never_zero(marks: Tensor) -> Tensor:
    return torch.where(marks == 0, 1, marks)
