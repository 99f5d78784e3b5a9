"""Matched pairs of photographs as a test of cameras.

The matches of a pair were verified from its two photographs only. With right cameras they lie near each other's
epipolar lines. Many pairs that do not are a contradiction, which the error of the points hides: mapping leaves out the
matches that do not fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..cameras import Similarity
from .pieces import LEAST_MATCHES, Poses, poses_of

_TOLERANCE = 1 / 160  # distance from an epipolar line, relative to the longer side of a photograph
_AS_GOOD = 0.9  # cameras with this share of the best ones' agreeing pairs and explained features are as good
LEAST_AGREEING = 0.72
"""Share of matched pairs that agree, below which cameras may be wrong."""
MOST_APART = 0.1
"""Distance of two reconstructions of the cameras, relative to their spread, above which they are different."""


@dataclass(frozen=True)
class Agreement:
    """Pairs of photographs whose matches agree with cameras, and all matched pairs that have cameras."""

    agreeing: int
    pairs: int

    @property
    def share(self) -> float:
        """Share of the pairs that agree; 0 without any."""
        return self.agreeing / max(self.pairs, 1)

    @property
    def is_good(self) -> bool:
        """Whether the pairs do not contradict the cameras."""
        return self.share >= LEAST_AGREEING


def agreement(colmap: Any, database: Path, model: Any) -> Agreement:
    """Count the matched pairs of a database, and those of which at least half of the matches fit a model."""
    poses, agreeing, pairs = poses_of(model), 0, 0
    with colmap.Database.open(database) as opened:
        rays = {number: _rays(image.camera, opened.read_keypoints(number)) for number, (image, _, _) in poses.items()}
        for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = colmap.pair_id_to_image_pair(pair)
            matches = np.asarray(geometry.inlier_matches)
            if len(matches) < LEAST_MATCHES or first not in poses or second not in poses:
                continue
            distance = epipolar_distance(
                rays[first][matches[:, 0]], rays[second][matches[:, 1]], _essential(poses, first, second)
            )
            lens = poses[first][0].camera
            pairs += 1
            agreeing += bool(
                np.median(np.nan_to_num(distance, nan=np.inf)) * lens.mean_focal_length()
                < _TOLERANCE * max(lens.width, lens.height)
            )
    return Agreement(agreeing, pairs)


def drop_flat(colmap: Any, database: Path) -> int:
    """Remove the matches of pairs that show no depth: a turn of the camera, a shift or a plane; return how many."""
    kinds = colmap.TwoViewGeometryConfiguration
    flat = (kinds.PLANAR_OR_PANORAMIC, kinds.PLANAR, kinds.PANORAMIC, kinds.WATERMARK)
    with colmap.Database.open(database) as opened:
        found = [
            pair
            for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True)
            if geometry.config in flat and len(geometry.inlier_matches)
        ]
        for pair in found:
            opened.delete_inlier_matches(*colmap.pair_id_to_image_pair(pair))
    return len(found)


def initial_pairs(colmap: Any, database: Path) -> list[tuple[int, int]]:
    """List pairs of photographs to begin with: those of most matches, each photograph once."""
    with colmap.Database.open(database) as opened:
        found = [
            (-len(geometry.inlier_matches), colmap.pair_id_to_image_pair(pair))
            for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True)
        ]
    pairs: list[tuple[int, int]] = []
    for _, (first, second) in sorted(found):
        if not {first, second} & {number for pair in pairs for number in pair}:
            pairs.append((first, second))
    return pairs


def choose(found: Sequence[tuple[Any, Agreement]]) -> tuple[Any, list[Any]]:
    """Choose the model that explains most features, among those that agree with nearly as many pairs as the best one.

    Returns the model, None if there is none, and those that explain nearly as many features.
    """
    most = max((pairs.agreeing for _, pairs in found), default=0)
    good = [(model.compute_num_observations(), model) for model, pairs in found if pairs.agreeing >= _AS_GOOD * most]
    count, best = max(good, key=lambda one: one[0], default=(0, None))
    return best, [model for features, model in good if model is not best and features >= _AS_GOOD * count]


def epipolar_distance(first: np.ndarray, second: np.ndarray, essential: np.ndarray) -> np.ndarray:
    """Compute the distances of matches from epipolar lines, to first order (Sampson), on images of focal length 1.

    Hartley, Zisserman: Multiple View Geometry, 2nd ed. (2004), eq. 11.9.

    Args:
        first, second: [P, 3], directions (x, y, 1) of the matches.
        essential: [3, 3], for which second · essential · first is 0.
    """
    ahead, back = first @ essential.T, second @ essential
    slope = (ahead[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1)
    distance: np.ndarray = np.abs((second * ahead).sum(1)) / np.sqrt(np.maximum(slope, np.finfo(float).tiny))
    return distance


def apart(model: Any, other: Any) -> float:
    """Measure how far two models place the same photographs: the median distance, relative to the spread of the places.

    The similarity that fits best is applied first. 0 if they share fewer than three photographs.
    """
    ours, theirs = poses_of(model), poses_of(other)
    shared = sorted(ours.keys() & theirs.keys())
    if len(shared) < 3:
        return 0.0
    rotations, places = (
        [torch.from_numpy(np.stack([poses[n][part] for n in shared])) for poses in (ours, theirs)] for part in (1, 2)
    )
    moved = Similarity.of_poses(*zip(rotations, places, strict=True)).points(places[0])
    spread = float((places[1] - places[1].mean(0)).norm(dim=1).mean())
    return float(np.median((moved - places[1]).norm(dim=1))) / max(spread, np.finfo(float).tiny)


def _rays(lens: Any, features: np.ndarray) -> np.ndarray:
    """Compute directions [P, 3] with z = 1 of features [P, ≥ 2]."""
    return np.column_stack((lens.cam_from_img(features[:, :2]), np.ones(len(features))))


def _essential(poses: Poses, first: int, second: int) -> np.ndarray:
    """Compute the essential matrix [3, 3] of two cameras, of a translation of length 1."""
    (_, one, start), (_, other, end) = poses[first], poses[second]
    shift = other @ (start - end)
    shift = shift / max(float(np.linalg.norm(shift)), np.finfo(float).tiny)
    return np.cross(np.eye(3), shift) @ (other @ one.T)
