"""Which colours a painting has, as a distance from them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_LIGHT = 0.15  # of the brightness, by which the light on an object changes it
_LEAST = 0.02  # standard deviation; a painting of one colour leaves a little room too
_WITHIN = 2.5  # standard deviations around the mean, where nearly all colours of a painting are

_ROUND = 0.1  # standard deviations, in which the loss goes from flat to linear


@dataclass(frozen=True, eq=False)
class Palette:
    """The mean and the covariance of a painting's colours, in the light that is on an object.

    Gram matrices count how often features come together, and a narrow network has too few of them to tell each colour
    from a mixture of others: it takes cream for yellow beside pink. Colours far outside the painting's own ellipsoid
    are therefore held back, those inside are free.

    Attributes:
        mean: [3].
        whiten: [3, 3], takes a difference from the mean to standard deviations.
    """

    mean: Tensor
    whiten: Tensor

    @classmethod
    def of(cls, painting: Tensor, mask: Tensor) -> Palette:
        """Of a painting [1, 3, h, w] in [0, 1] where its mask [1, h, w] in [0, 1] is."""
        colours, shares = painting[0].flatten(1).T, mask.flatten() / mask.sum().clamp(min=1e-6)
        mean = shares @ colours
        centred = colours - mean
        covariance = centred.T @ (centred * shares[:, None]) + _LIGHT**2 * torch.outer(mean, mean)
        spread, axes = torch.linalg.eigh(covariance)
        # Along an axis the least deviation adds to the painting's, so that the distance changes smoothly with it.
        return cls(mean, axes / (spread.clamp(min=0) + _LEAST**2).sqrt())

    def excess(self, colours: Tensor) -> Tensor:
        """By how many standard deviations colours [..., 3] are beyond 2.5 of them, [...]; 0 within, and about linear.

        Squares would have gradients so large, where colours begin far away, that Adam takes small steps long after.
        """
        distance = ((colours - self.mean) @ self.whiten).square().sum(-1)
        beyond = distance.clamp(min=_WITHIN**2).sqrt() - _WITHIN
        return (beyond.square() + _ROUND**2).sqrt() - _ROUND
