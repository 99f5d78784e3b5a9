"""Light from all around, as nine coefficients for each colour."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from .. import validate
from ..camera.parameters import Array, batch_of, batch_size, parameter
from ..meshes.normals import face_normals

_PI = math.pi
# What a matt surface keeps of each band, as parts of the light that falls on it: max(cos, 0) / π in harmonics.
_BANDS = torch.tensor([1.0] + [2 / 3] * 3 + [1 / 4] * 5)


@dataclass(frozen=True, eq=False)
class SphericalHarmonicLight:
    """Distant light from all directions, for a scene or one for each scene of a batch.

    The light on a matt surface with normal n is Σ A_l L_lm Y_lm(n) over the bands l = 0, 1, 2, which is within 1 % of
    the truth for any distant light (Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment
    Maps", 2001), with A = 1, 2/3, 1/4: light of radiance 1 from everywhere gives a white surface its own colour.

    coefficients: [9, 3] or [B, 9, 3], L_lm for each colour, in the order (l, m) = (0, 0), (1, −1), (1, 0), (1, 1),
        (2, −2), …, (2, 2), with real harmonics of the world's x, y, z: those of band 1 go with y, z, x. The light of
        radiance 1 from everywhere is √(4π) in the first. What comes out below 0 is 0. Gradients reach a tensor.
    """

    coefficients: Array

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        """The light on both sides of each face [B, 2, F, 3 colours]: see `Light.two_sided`, which it agrees with."""
        validate.floating("corners", corners, ("B", "F", 3, 3))
        normals = face_normals(corners)
        if not mirrored:
            normals = -normals
        return torch.stack((self.on(normals), self.on(-normals)), dim=1)

    def on(self, normals: Tensor) -> Tensor:
        """The light [B, ..., 3 colours] on surfaces with unit normals [B, ..., 3], floating: of faces or of pixels."""
        validate.floating("normals", normals, ("B",) + ("N",) * max(1, getattr(normals, "ndim", 3) - 2) + (3,))
        values = parameter("coefficients", self.coefficients, (9, 3), normals.dtype, normals.device)
        batch_size(normals=normals.shape[0], coefficients=batch_of(values, 2))
        kept = values.reshape(-1, 9, 3) * _BANDS.to(values)[:, None]
        flat = normals.flatten(1, -2)
        light = (_harmonics(flat) @ kept).clamp(min=0)
        return light.view(len(light), *normals.shape[1:-1], 3)


def _harmonics(n: Tensor) -> Tensor:
    """The nine real spherical harmonics [..., 9] of unit vectors [..., 3]."""
    x, y, z = n.unbind(-1)
    one, two = math.sqrt(3 / (4 * _PI)), math.sqrt(15 / (4 * _PI))
    bands = [torch.full_like(x, math.sqrt(1 / (4 * _PI))), one * y, one * z, one * x, two * x * y, two * y * z]
    bands += [math.sqrt(5 / (16 * _PI)) * (3 * z * z - 1), two * x * z, two / 2 * (x * x - y * y)]
    return torch.stack(bands, -1)
