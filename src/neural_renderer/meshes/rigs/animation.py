"""Interpolation of animated properties, as glTF 2.0 defines them (appendix C of the specification)."""

from __future__ import annotations

import numpy as np

from ...io.gltf.rig_reader import Track


def sampled(track: Track, times: np.ndarray) -> np.ndarray:
    """Interpolate a track at times [N] in seconds: [N, width]. Before the first and after the last key it is constant.

    Rotations are unit quaternions (x, y, z, w).
    """
    keys = track.times
    before = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 1)
    after = np.minimum(before + 1, len(keys) - 1)
    step = keys[after] - keys[before]
    t = np.clip((times - keys[before]) / np.where(step > 0, step, 1), 0, 1)[:, None]
    if track.interpolation == "CUBICSPLINE":
        _, first, leaving = track.values[before].swapaxes(0, 1)
        arriving, last, _ = track.values[after].swapaxes(0, 1)
        values = _hermite(t, first, leaving * step[:, None], last, arriving * step[:, None])
    else:
        first, last = track.values[before], track.values[after]
        if track.interpolation == "STEP":
            values = np.where(t < 1, first, last)
        elif track.path == "rotation":
            values = _slerp(t, first, last)
        else:
            values = first + t * (last - first)
    if track.path == "rotation":
        values = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-30)
    return values


def _hermite(
    t: np.ndarray, first: np.ndarray, leaving: np.ndarray, last: np.ndarray, arriving: np.ndarray
) -> np.ndarray:
    """Interpolate by cubic Hermite splines."""
    square, cube = t**2, t**3
    start = (2 * cube - 3 * square + 1) * first + (cube - 2 * square + t) * leaving
    return start + (3 * square - 2 * cube) * last + (cube - square) * arriving


def _slerp(t: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Interpolate spherically between quaternions [N, 4] on the shorter arc (Shoemake, 1985)."""
    cosine = (first * last).sum(1, keepdims=True)
    last = np.where(cosine < 0, -last, last)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    sine = np.sin(angle)
    small = sine < 1e-6
    divisor = np.where(small, 1, sine)
    start = np.where(small, 1 - t, np.sin((1 - t) * angle) / divisor)
    return start * first + np.where(small, t, np.sin(t * angle) / divisor) * last
