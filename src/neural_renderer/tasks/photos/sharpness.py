"""Sharpness of pictures."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def sharpness(grey: np.ndarray) -> float:
    """Measure how sharp a grey picture [H, W] is: the deviation of its Laplacian, relative to its contrast."""
    values = ndimage.gaussian_filter(grey.astype(np.float32), 1)
    return float(ndimage.laplace(values).std() / max(float(values.std()), 1e-3))
