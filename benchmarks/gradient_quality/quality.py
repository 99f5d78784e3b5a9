"""Comparison of samples of a gradient with the truth: size, direction and noise, with 95 % intervals."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Quality:
    """Comparison of an estimator's mean gradient with the truth, both flattened.

    Attributes:
        size: Length of the mean along the truth, relative to it; 1 is right.
        interval: Half of the 95 % interval of the size, over the samples.
        cosine: Between mean and truth.
        noise: Root mean square deviation of a sample from the mean, relative to the truth.
    """

    size: float
    interval: float
    cosine: float
    noise: float

    @classmethod
    def of(cls, samples: Tensor, truth: Tensor) -> Quality:
        """Compare samples with the truth, [N, D] each, one row per shift; the truth may differ between rows."""
        samples, truth = samples.double(), truth.double().expand(len(samples), -1)
        mean, target = samples.mean(0), truth.mean(0)
        length = (target * target).sum()
        sizes = ((samples - truth) @ target) / length + 1
        spread = (samples - truth - (mean - target)).square().sum(1).mean().sqrt()
        interval = 1.96 * sizes.std() / len(samples) ** 0.5 if len(samples) > 1 else torch.tensor(torch.inf)
        noise = spread / truth.square().sum(1).mean().sqrt()
        cosine = torch.cosine_similarity(mean, target, dim=0)
        return cls(float(sizes.mean()), float(interval), float(cosine), float(noise))
