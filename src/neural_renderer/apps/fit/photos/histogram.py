"""Histograms of colours, and how much likelier a colour is in one of them."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

_BINS = 16  # of each colour
_SMOOTH = 0.7  # bins by which counts are smoothed
_NOTHING = 1e-5  # likelihood of a colour that does not occur
MOST = 2.5
"""Most logarithm of the ratio of two likelihoods, of one pixel."""


def bins_of(colors: np.ndarray) -> np.ndarray:
    """Number the bins [...] of colours [..., 3] in [0, 1]."""
    index = (colors * (_BINS - 1e-3)).astype(np.int64)
    return np.asarray((index[..., 0] * _BINS + index[..., 1]) * _BINS + index[..., 2])


def histogram(bins: np.ndarray) -> np.ndarray:
    """Count colours by their bins, smoothed: [bins³], of sum 1."""
    counts = np.bincount(bins.ravel(), minlength=_BINS**3).astype(np.float64).reshape((_BINS,) * 3)
    smooth = ndimage.gaussian_filter(counts, _SMOOTH).ravel()
    return smooth / max(float(smooth.sum()), 1e-9)


def log_ratio(ours: np.ndarray, others: np.ndarray, bins: np.ndarray) -> np.ndarray:
    """Compute the logarithm of how much likelier colours are in one histogram than in another, at most ``MOST``."""
    return np.asarray(np.log((ours + _NOTHING) / (others + _NOTHING))[bins].clip(-MOST, MOST))
