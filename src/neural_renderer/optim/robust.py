"""Robust losses ρ of squared residuals, for iteratively reweighted least squares.

Source: Barron, "A general and adaptive robust loss function", CVPR 2019, lists them in one notation.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Loss = Callable[[Tensor], tuple[Tensor, Tensor]]
"""From squares s of residuals to ρ(s) and its derivative, the weight; both in units of the scale. ρ(s) ≈ s near 0."""


def _squares(s: Tensor) -> tuple[Tensor, Tensor]:
    return s, torch.ones_like(s)


def _huber(s: Tensor) -> tuple[Tensor, Tensor]:
    size = s.clamp(min=1.0).sqrt()
    return torch.where(s <= 1, s, 2 * size - 1), 1 / size


def _cauchy(s: Tensor) -> tuple[Tensor, Tensor]:
    return torch.log1p(s), 1 / (1 + s)


def _geman_mcclure(s: Tensor) -> tuple[Tensor, Tensor]:
    return s / (1 + s), 1 / (1 + s).square()


LOSSES: dict[str, Loss] = {
    "squares": _squares,
    "huber": _huber,
    "cauchy": _cauchy,
    "geman_mcclure": _geman_mcclure,
}
