"""Surroundings of an object with masks: whether the object stands still in them, so that they show the cameras, too."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .....io import load_image
from ..copies import IMAGES, MASKS
from ..missing import MOST_TURN, turn_error

_TRIED = 12  # consecutive photographs whose pairs are all compared
_LEAST = 10  # least number of matches that determine the motion of a part of two photographs
_TOLERANCE = 0.003  # pixels relative to the longer side; matches that moved less than twice as far are still
_FLAT = 0.8  # share of matches explained by a homography, above which the scene is flat or the camera only turned
_TOGETHER = 0.75  # share of the matches of both parts that one motion of the camera explains if nothing else moved


def stands_still(colmap: Any, folder: Path, names: Sequence[str], features: Any, matching: Any) -> bool:
    """Test whether an object with masks stands still in its surroundings, by matches of some photographs.

    It does if one motion of the camera explains the matches inside and outside of the masks. It does not if the
    surroundings are static in the pictures, as behind a turntable, or move differently; without features this is
    unknown, and the result False. The options are those of features and of matching.
    """
    first = max(0, (len(names) - _TRIED) // 2)
    tried, votes = names[first : first + _TRIED], []
    with tempfile.TemporaryDirectory() as place:
        database = Path(place) / "database.db"
        colmap.extract_features(database, folder / IMAGES, image_names=tried, extraction_options=features)
        colmap.match_exhaustive(database, matching)
        with colmap.Database.open(database) as opened:
            images = {image.image_id: image for image in opened.read_all_images()}
            lenses = {number: opened.read_camera(image.camera_id) for number, image in images.items()}
            places = {number: opened.read_keypoints(number)[:, :2].astype(float) for number in images}
            inside = {number: inside_mask(folder, image.name, places[number]) for number, image in images.items()}
            for pair, matches in zip(*opened.read_all_matches(), strict=True):
                one, other = colmap.pair_id_to_image_pair(pair)
                here, there = np.asarray(matches).reshape(-1, 2).T
                parts = inside[one][here] & inside[other][there], ~inside[one][here] & ~inside[other][there]
                matched = places[one][here], places[other][there]
                votes.append(_moves_as_one(colmap, (lenses[one], lenses[other]), matched, parts))
    # Pairs that show both parts decide; without any, what is around the object is all that there is.
    best = max((weight for weight, _ in votes), default=0)
    answers = [answer for weight, answer in votes if weight == best]
    return best > 0 and 2 * sum(answers) > len(answers)


def inside_mask(folder: Path, name: str, places: np.ndarray) -> np.ndarray:
    """Test which features [N, 2] of a photograph are inside its mask; all are, without a mask."""
    file = folder / MASKS / f"{name}.png"
    if not file.is_file():
        return np.ones(len(places), bool)
    alpha = load_image(file)[..., 0].numpy()
    columns, rows = places.astype(int).T
    return np.asarray(alpha[rows.clip(0, alpha.shape[0] - 1), columns.clip(0, alpha.shape[1] - 1)] > 0)


def _moves_as_one(
    colmap: Any, lenses: Sequence[Any], places: tuple[np.ndarray, np.ndarray], parts: tuple[np.ndarray, np.ndarray]
) -> tuple[int, bool]:
    """Test whether one motion of the camera explains matches [N, 2] in and around an object; return also its weight.

    The weight is 2 if both parts determine a motion, 1 if only the surroundings do, and 0 otherwise.
    """
    first, second = places
    options = colmap.RANSACOptions()
    options.max_error, options.random_seed = _TOLERANCE * max(lenses[0].width, lenses[0].height), 0
    moved = np.linalg.norm(first - second, axis=1) > 2 * options.max_error

    def explained(rows: np.ndarray) -> np.ndarray:
        found = colmap.estimate_essential_matrix(first[rows], second[rows], *lenses, options)
        return rows[found["inlier_mask"]] if found else rows[:0]

    inside, around = (explained(np.flatnonzero(part & moved)) for part in parts)
    weight = 2 if len(inside) >= _LEAST else 1
    still = int((parts[1] & ~moved).sum())
    if len(around) < max(_LEAST, still):
        return (weight if weight > 1 or still >= _LEAST else 0), False
    flat = colmap.estimate_homography_matrix(first[around], second[around], options)
    if flat and flat["num_inliers"] >= _FLAT * len(around):
        one, other = (lens.calibration_matrix() for lens in lenses)
        if turn_error(np.linalg.inv(other) @ flat["H"] @ one) < MOST_TURN:
            return weight, False
    both = explained(np.concatenate([inside, around]))
    shares = [float(np.isin(part, both).mean()) for part in (around, inside)[:weight]]
    return weight, min(shares) >= _TOGETHER
