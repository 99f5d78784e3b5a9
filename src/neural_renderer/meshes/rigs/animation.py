"""Interpolation of animated properties, as glTF 2.0 defines them (appendix C of the specification)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...io.gltf.rig_reader import Track


def alike(tracks: Iterable[Track]) -> list[list[Track]]:
    """Group tracks that `sampled` takes together; of several of one property of a joint, the last one remains."""
    groups: dict[tuple[object, ...], list[Track]] = {}
    for track in {(track.path, track.joint): track for track in tracks}.values():
        key = track.path, track.interpolation, id(track.times), track.values.shape
        groups.setdefault(key, []).append(track)
    return list(groups.values())


def sampled(tracks: list[Track], times: np.ndarray) -> np.ndarray:
    """Interpolate K tracks, which are alike, at times [N] in seconds: [N, K, width].

    Before the first and after the last key values are constant. Rotations are unit quaternions (x, y, z, w).
    """
    keys, path, interpolation = tracks[0].times, tracks[0].path, tracks[0].interpolation
    before = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 1)
    after = np.minimum(before + 1, len(keys) - 1)
    step = keys[after] - keys[before]
    t = np.clip((times - keys[before]) / np.where(step > 0, step, 1), 0, 1)[:, None, None]
    start = np.stack([track.values[before] for track in tracks], 1)
    end = np.stack([track.values[after] for track in tracks], 1)
    if interpolation == "CUBICSPLINE":
        step = step[:, None, None]
        values = _hermite(t, start[:, :, 1], start[:, :, 2] * step, end[:, :, 1], end[:, :, 0] * step)
    elif interpolation == "STEP":
        values = np.where(t < 1, start, end)
    elif path == "rotation":
        values = _slerp(t, start, end)
    else:
        values = start + t * (end - start)
    if path == "rotation":
        values = values / np.maximum(np.linalg.norm(values, axis=-1, keepdims=True), 1e-30)
    return values


def _hermite(
    t: np.ndarray, first: np.ndarray, leaving: np.ndarray, last: np.ndarray, arriving: np.ndarray
) -> np.ndarray:
    """Interpolate by cubic Hermite splines."""
    square, cube = t**2, t**3
    start = (2 * cube - 3 * square + 1) * first + (cube - 2 * square + t) * leaving
    return start + (3 * square - 2 * cube) * last + (cube - square) * arriving


def _slerp(t: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Interpolate spherically between quaternions [..., 4] on the shorter arc (Shoemake, 1985)."""
    cosine = (first * last).sum(-1, keepdims=True)
    last = np.where(cosine < 0, -last, last)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    sine = np.sin(angle)
    small = sine < 1e-6
    divisor = np.where(small, 1, sine)
    start = np.where(small, 1 - t, np.sin((1 - t) * angle) / divisor)
    return start * first + np.where(small, t, np.sin(t * angle) / divisor) * last
