"""How far float32 may be off, so that comparisons hold for any processor, library, and order of a sum.

An operation is off by at most EPS of its result. A sum of n terms is off by at most n EPS of the sum of the terms'
sizes, in whatever order it is taken and with or without fused multiplications (Higham, Accuracy and Stability of
Numerical Algorithms, section 4.2). So is a product of matrices, and a chain of n operations that do not cancel.

The default of `torch.testing.assert_close`, 22 EPS of the number and 168 EPS of 1, is for a few operations on numbers
around 1.
"""

from __future__ import annotations

EPS = 2.0**-24

STEP = 1 / 255
"""Colours in files are multiples of this; rounding to one is off by at most half of it."""


def rounding(operations: int, size: float = 1.0) -> dict[str, float]:
    """Make arguments of `assert_close` for a number of roundings of numbers up to ``size``."""
    return {"rtol": 0.0, "atol": operations * EPS * size}


def relative(operations: int) -> dict[str, float]:
    """Make arguments of `assert_close` for a number of roundings of positive numbers, without cancellation."""
    return {"rtol": operations * EPS, "atol": 0.0}
