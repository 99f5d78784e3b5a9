"""`LightFit`: the light of photographs, by least squares while the shape and its albedo are fitted."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ....shading.spherical_harmonics import harmonics

_DECAY = 0.95  # of the sums over earlier steps
_MOST_PIXELS = 60_000  # of a step
_EXACT = 0.02  # residual below which weights do not grow
_RIDGE = 1e-3  # weight of no light but a uniform one, relative to that of the pixels


class LightFit:
    """Diffuse light of order 2, the same for all photos: nine factors of the spherical harmonics for each channel.

    The colour of a pixel is albedo · Σ c_k Y_k(normal), which is linear in c. Every step adds its pixels to the normal
    equations, in which earlier steps fade away. Weights are those of the sum of absolute residuals, so that highlights
    and cast shadows count little.

    Args:
        like: A tensor of the dtype and device to compute with.

    Attributes:
        factors: [9, 3], c: the coefficients of a `SphericalHarmonicLight`, times the factor of their band.

    Example:
        >>> from neural_renderer.tasks.fit.detail.light_fit import LightFit
        >>> normals = torch.nn.functional.normalize(torch.randn(500, 3), dim=1)
        >>> light, white = LightFit(normals), torch.ones(500, 3)
        >>> for _ in range(10):
        ...     light.add(normals, white, 0.5 + 0.3 * normals[:, 1:2].expand(-1, 3))
        >>> light.on(torch.tensor([0.0, 1.0, 0.0])).sub(0.8).abs().max() < 0.01
        tensor(True)
    """

    def __init__(self, like: Tensor) -> None:
        self.factors = like.new_zeros(9, 3)
        self.factors[0] = 1 / float(harmonics(like.new_zeros(3))[0])
        self._left, self._right = like.new_zeros(3, 9, 9), like.new_zeros(3, 9)

    def on(self, normals: Tensor) -> Tensor:
        """Compute the light on surfaces with unit normals [..., 3], which are on the lit side: RGB [..., 3]."""
        return torch.stack(harmonics(normals), -1) @ self.factors

    @torch.no_grad()
    def add(self, normals: Tensor, albedo: Tensor, colors: Tensor) -> None:
        """Add pixels, and solve for the light.

        Args:
            normals: [P, 3], unit normals.
            albedo: [P, 3].
            colors: [P, 3], of the photos.
        """
        some = slice(None, None, 1 + len(normals) // _MOST_PIXELS)
        normals, albedo, colors = normals[some], albedo[some], colors[some]
        bands = torch.stack(harmonics(normals), 1)
        weights = 1 / (albedo * (bands @ self.factors) - colors).abs().clamp(min=_EXACT)
        rows = albedo.t()[:, :, None] * bands  # [3, P, 9]
        weighted = rows * weights.t()[:, :, None]
        self._left = _DECAY * self._left + weighted.mT @ rows
        self._right = _DECAY * self._right + (weighted.mT @ colors.t()[:, :, None])[..., 0]
        ridge = torch.ones_like(bands[0])
        ridge[0] = 0.0
        size = self._left[:, 0, 0].clamp(min=1e-9)[:, None, None]
        left = self._left + size * (_RIDGE * torch.diag(ridge) + 1e-6 * torch.eye(9).to(size))
        self.factors = torch.linalg.solve(left.double(), self._right.double()).t().to(normals)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        return {"factors": self.factors, "left": self._left, "right": self._right}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self.factors, self._left, self._right = state["factors"], state["left"], state["right"]
