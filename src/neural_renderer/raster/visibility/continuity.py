"""Where colours go on from face to face: numbers for each edge that tell, when compared with the other face's."""

from __future__ import annotations

import torch
from torch import Tensor

_ODD = 0x9E3779B97F4A7C15 - 2**64  # the golden ratio in 64 bits, whose powers' bits are as good as random
_THERE, _BACK = 0x2545F4914F6CDD1D, 0x5851F42D4C957F2D


def texture_marks(textures: Tensor, light: Tensor) -> Tensor:
    """Marks [B, F, 3, 2] int64 for `boundaries`, of texture cubes [B, F, T, T, T, 3] and light [B, 2, F, 3].

    For edge k, from corner k to the next, one of what is on it in this order, and one of the same in the other. The
    first is equal to the second of the face beyond if the texels that are blended on the edge are, to about one part in
    4000, and the light is.
    """
    size, flat = textures.shape[2], textures.detach().flatten(2, 4)
    texel = torch.arange(size**3, device=flat.device).view(size, size, size)
    place = texel[0, 0]
    near = (place[:, None] + place - (size - 1)).abs() <= 1
    # Along the first corner's axis, then along the second's.
    sides = torch.stack([side[near] for side in (texel[:, :, 0], texel[0], texel[:, 0].T)])  # [3, N]
    first, second = near.nonzero().T
    colors = _hash(_digits(flat[:, :, sides.flatten()])).unflatten(2, sides.shape)
    there = _mixed(colors + first * _THERE + second * _BACK).sum(3)
    back = _mixed(colors + second * _THERE + first * _BACK).sum(3)
    return _never_zero(torch.stack((there, back), 3) + _light_hash(light))


def image_marks(uv: Tensor, image_index: Tensor, light: Tensor | None) -> Tensor:
    """Likewise [1 or B, F, 3, 2] of texture coordinates [F, 3, 2] on images of that index [F], which must be equal."""
    corners = _hash(torch.cat((_bits(uv.detach()).long(), image_index.long()[:, None, None].expand(-1, 3, 1)), 2))
    following = corners.roll(-1, 1)
    marks = torch.stack((corners * _THERE + following * _BACK, following * _THERE + corners * _BACK), 2)
    # A face without an image has colours of its own.
    own = _hash(torch.arange(len(uv), device=uv.device)[:, None] + 1)[:, None, None]
    marks = _mixed(torch.where(image_index[:, None, None] < 0, own, marks))[None]
    return _never_zero(marks if light is None else marks + _light_hash(light))


def _light_hash(light: Tensor) -> Tensor:
    """[B, F, 1, 1] of the factors [B, 2, F, 3] on both sides of each face."""
    return _hash(_digits(light.detach()).permute(0, 2, 1, 3).flatten(2))[..., None, None]


def _digits(values: Tensor) -> Tensor:
    """Whole numbers that are equal for values that are to one part in 4000: 12 of a float's 23 bits are left."""
    return (_bits(values) + (1 << 10)) >> 11


def _bits(values: Tensor) -> Tensor:
    """Those of float32, int32; the same for 0 and -0."""
    return (values.float() + 0.0).view(torch.int32)


def _hash(numbers: Tensor) -> Tensor:
    """One int64 for the last dimension's."""
    result = torch.zeros(numbers.shape[:-1], dtype=torch.int64, device=numbers.device)
    for part in numbers.unbind(-1):
        result = (result + part) * _ODD
    return _mixed(result)


def _mixed(number: Tensor) -> Tensor:
    number = (number ^ (number >> 32)) * _ODD
    return number ^ (number >> 29)


def _never_zero(marks: Tensor) -> Tensor:
    return torch.where(marks == 0, 1, marks)
