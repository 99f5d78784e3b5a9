"""Outlines of a drawing of the object, moved to where colours change, within a few pixels.

In a window around each pixel, the colours surely inside and surely outside are separated by Fisher's linear
discriminant ("The use of multiple measurements in taxonomic problems", 1936).
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

_BAND = 4  # pixels on each side of an outline in which colours decide
_WINDOW = 19  # pixels a side
_NOISE = 0.03  # standard deviation of colours
_MOST, _SHAPE = 3.0, 1.0  # most evidence of a colour, and that of the outline at the end of the band


def sharpen(image: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Move the outline of a mask [H, W] to edges of an image [H, W, 3]; returns a mask."""
    if not inside.any() or inside.all():
        return inside
    distance = ndimage.distance_transform_edt(inside) - ndimage.distance_transform_edt(~inside)
    ours, others = _statistics(image, distance > _BAND), _statistics(image, distance < -_BAND)
    evidence = np.zeros(inside.shape)
    band = (np.abs(distance) <= _BAND) & (np.minimum(ours[0], others[0]) > 0.5 / _WINDOW**2)
    if band.any():
        means = ours[1][band], others[1][band]
        spread = (ours[2][band] + others[2][band]) / 2 + _NOISE**2 * np.eye(3)
        slope = np.linalg.solve(spread, (means[0] - means[1])[..., None])[..., 0]
        value = (slope * (image[band] - (means[0] + means[1]) / 2)).sum(1)
        evidence[band] = np.clip(value, -_MOST, _MOST)
    smooth = ndimage.gaussian_filter(evidence, 1.0)
    found = np.where(np.abs(distance) <= _BAND, smooth + _SHAPE * distance / _BAND > 0, inside)
    return np.asarray(ndimage.binary_opening(ndimage.binary_closing(found), iterations=1) | (distance > _BAND))


def _statistics(image: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the share of chosen pixels in the window around each pixel, their mean colour and its covariance."""

    def mean(values: np.ndarray) -> np.ndarray:
        return ndimage.uniform_filter(values * chosen, _WINDOW, mode="constant")

    share = mean(np.ones(chosen.shape))
    least = np.maximum(share, 1e-6)
    color = np.stack([mean(image[..., k]) / least for k in range(3)], -1)
    spread = np.empty((*chosen.shape, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            product = mean(image[..., a] * image[..., b]) / least - color[..., a] * color[..., b]
            spread[..., a, b] = spread[..., b, a] = product
    return share, color, spread
