"""`Palette`: the colour distribution of a painting, as a loss."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_LIGHT = 0.15  # standard deviation of the brightness due to the light on an object, relative to the mean colour
_LEAST = 0.02  # least standard deviation, for paintings of one colour
_WITHIN = 2.5  # standard deviations around the mean that are free: nearly all colours of a painting
_ROUND = 0.1  # standard deviations over which the loss changes from flat to linear


@dataclass(frozen=True, eq=False)
class Palette:
    """Mean and covariance of a painting's colours, widened by the light on an object.

    The Gram matrices of a narrow network do not tell every colour from a mixture of others: it takes cream for yellow
    beside pink. Colours outside the ellipsoid of the painting's colours are therefore penalised; those inside are free.

    Attributes:
        mean: [3], mean RGB.
        whiten: [3, 3], maps a difference from the mean to standard deviations.
    """

    mean: Tensor
    whiten: Tensor

    @classmethod
    def of(cls, painting: Tensor, mask: Tensor) -> Palette:
        """Measure the colours of a painting [1, 3, h, w] in [0, 1], weighted by its mask [1, h, w] in [0, 1]."""
        colors, weights = painting[0].flatten(1).T, mask.flatten() / mask.sum().clamp(min=1e-6)
        mean = weights @ colors
        offset = colors - mean
        covariance = offset.T @ (offset * weights[:, None]) + _LIGHT**2 * torch.outer(mean, mean)
        variance, axes = torch.linalg.eigh(covariance)
        # The least variance is added, not a lower bound, so that distances depend smoothly on the painting.
        return cls(mean, axes / (variance.clamp(min=0) + _LEAST**2).sqrt())

    def excess(self, colors: Tensor) -> Tensor:
        """Compute by how many standard deviations colours [..., 3] are outside the free ellipsoid, [...]; 0 inside.

        The loss is linear far outside: squares would have such large gradients for distant initial colours that Adam's
        steps would stay small for a long time.
        """
        distance = ((colors - self.mean) @ self.whiten).square().sum(-1)
        beyond = distance.clamp(min=_WITHIN**2).sqrt() - _WITHIN
        return (beyond.square() + _ROUND**2).sqrt() - _ROUND
