"""Diffuse environment light as spherical harmonics of order 2."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..base import validate
from ..base.constants import on_device
from ..camera.parameters import Array, batch_of, batch_size, parameter
from ..meshes.normals import face_normals
from .lights import Ambience, FaceLight
from .pixels.planes import tinted

_PI = math.pi
# A_l / π: 1, 2/3 and 1/4 in bands 0, 1 and 2 (Ramamoorthi and Hanrahan, 2001, equation 8).
_BANDS = torch.tensor([1.0] + [2 / 3] * 3 + [1 / 4] * 5)


@dataclass(frozen=True, eq=False)
class SphericalHarmonicLight(FaceLight, Ambience):
    """Environment light of order 2, for one scene or for each scene of a batch.

    The light on a diffuse surface with normal n is Σ A_l L_lm Y_lm(n) over the bands l = 0, 1, 2, with A = 1, 2/3, 1/4.
    For any distant light this is within 1 % of the exact value (Ramamoorthi and Hanrahan, "An Efficient Representation
    for Irradiance Environment Maps", 2001). Uniform light of radiance 1 leaves albedo unchanged. Negative light is
    clamped to 0. In reflections, a lobe of roughness r blurs band l by about exp(−l (l + 1) r⁴ / 2) (Ramamoorthi and
    Hanrahan, "A Signal-Processing Framework for Inverse Rendering", 2001, section 4.2). Order 2 cannot represent sharp
    ones.

    Attributes:
        coefficients: [9, 3] or [B, 9, 3]: L_lm for each colour channel, in the order (l, m) = (0, 0), (1, −1), (1, 0),
            (1, 1), (2, −2), …, (2, 2). Real harmonics of world x, y, z: band 1 belongs to y, z, x. Uniform light of
            radiance 1 is √(4π) in the first row. Differentiable if it is a tensor.

    Raises:
        TypeError, ValueError: In drawing, `two_sided` or `on`, coefficients that do not fit or are not finite.

    Example:
        >>> coefficients = torch.zeros(9, 3)
        >>> coefficients[0] = 3.5449  # uniform white light
        >>> images = nr.render(mesh, camera, light=nr.SphericalHarmonicLight(coefficients))
    """

    coefficients: Array

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        validate.finite("corners", validate.floating("corners", corners, ("B", "F", 3, 3)))
        normals = face_normals(corners)
        if not mirrored:
            normals = -normals
        return torch.stack((self.on(normals), self.on(-normals)), dim=1)

    def on(self, normals: Tensor) -> Tensor:
        """Compute the light on surfaces with given normals.

        Args:
            normals: [B, ..., 3] floating unit vectors, of faces or of pixels.

        Returns:
            [B, ..., 3], one value for each colour channel, ≥ 0. Differentiable in normals and coefficients.

        Raises:
            TypeError, ValueError: A type or shape does not fit; or, while values are checked, a number is not finite.

        Example:
            >>> coefficients = torch.zeros(9, 3)
            >>> coefficients[0] = 3.5449  # uniform white light
            >>> nr.SphericalHarmonicLight(coefficients).on(torch.tensor([[[0.0, 1.0, 0.0]]]))
            tensor([[[1.0000, 1.0000, 1.0000]]])
        """
        validate.floating("normals", normals, ("B",) + ("N",) * max(1, getattr(normals, "ndim", 3) - 2) + (3,))
        validate.finite("normals", normals)
        values = parameter("coefficients", self.coefficients, (9, 3), normals.dtype, normals.device)
        batch_size(normals=normals.shape[0], coefficients=batch_of(values, 2))
        kept = values.reshape(-1, 9, 3) * on_device(_BANDS, values)[:, None]
        kept = kept.reshape(-1, *(1,) * (normals.ndim - 2), 9, 3)
        # Not matmul: it rounds under autocast, and its order of summation depends on the batch.
        bands = zip(harmonics(normals), kept.unbind(-2), strict=True)
        parts = (tinted(value[..., None], band) for value, band in bands)
        return sum(parts, torch.zeros_like(kept[..., 0, :])).clamp(min=0)

    def ambience(self, directions: Tensor, roughness: Tensor | None = None) -> Tensor:
        if roughness is None:
            return self.on(directions)
        values = parameter("coefficients", self.coefficients, (9, 3), directions.dtype, directions.device)
        batch_size(directions=len(directions), coefficients=batch_of(values, 2))
        rows = values.reshape(-1, 1, 1, 9, 3).unbind(-2)
        bands = [tinted(value[..., None], row) for value, row in zip(harmonics(directions), rows, strict=True)]
        variance = roughness**4 / 2
        first, second = torch.exp(-2 * variance), torch.exp(-6 * variance)
        return (bands[0] + first * sum(bands[1:4]) + second * sum(bands[4:])).clamp(min=0)


def harmonics(n: Tensor) -> list[Tensor]:
    """Evaluate the nine real spherical harmonics up to order 2 at unit vectors [..., 3]: nine tensors [...]."""
    x, y, z = n.unbind(-1)
    one, two = math.sqrt(3 / (4 * _PI)), math.sqrt(15 / (4 * _PI))
    bands = [torch.full_like(x, math.sqrt(1 / (4 * _PI))), one * y, one * z, one * x, two * x * y, two * y * z]
    return [*bands, math.sqrt(5 / (16 * _PI)) * (3 * z * z - 1), two * x * z, two / 2 * (x * x - y * y)]
