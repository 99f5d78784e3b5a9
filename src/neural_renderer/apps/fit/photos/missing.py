"""Reasons why photographs were not placed, and what would help."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ....camera import Camera
from ....io.images import load_reduced
from ...common.views.views import Views, downscale
from .copies import Photographs

BLURRED = 0.6
"""Sharpness, relative to the median of the set, below which a photograph counts as blurred."""
SHARP = 0.047
"""Sharpness of photographs that are just sharp enough."""
_SAME = 0.5  # share of features with a match, above which two photographs are nearly the same picture
_FEW_MATCHES = 30  # matches with the best partner, below which photographs are too far apart
_TURNS = 0.9  # least share of pairs that show a pure rotation for a camera that did not move
MOST_TURN = 0.06
"""Error of a homography, see `turn_error`, below which the motion of a camera is a pure rotation."""
_ONE_PLACE = 0.003  # distance of two cameras, relative to the median distance, and of their directions: one place
_ALIKE, _ALIKE_SIDE = 0.95, 64  # correlation of small pictures that show the same, and their longer side
_FOCAL = np.exp(np.linspace(-0.7, 0.7, 15))  # focal lengths that are tried, relative to the likely one


def turn_error(matrix: np.ndarray) -> float:
    """Measure how far a homography [3, 3] of directions is from a pure rotation.

    That of a camera that only turns is a multiple of a rotation, whose singular values are equal (Hartley and
    Zisserman, "Multiple View Geometry", 2004, section 8.4).
    """
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(abs(values / values[1] - 1).max())


def only_turned(colmap: Any, database: Any) -> bool:
    """Test whether nearly all matched pairs of an open database show a pure rotation."""
    lenses = {image.image_id: database.read_camera(image.camera_id) for image in database.read_all_images()}
    found = [
        ([lenses[number].calibration_matrix() for number in colmap.pair_id_to_image_pair(pair)], geometry)
        for pair, geometry in zip(*database.read_two_view_geometries(), strict=True)
        if len(geometry.inlier_matches) >= _FEW_MATCHES
    ]
    flat = [(pair, geometry.H) for pair, geometry in found if geometry.config in _flat(colmap)]
    if len(flat) < max(len(lenses) / 2, _TURNS * len(found)):
        return False
    # A wrong focal length makes turns look like motions; that of all photographs is likely the same.
    scales = [np.diag([focal, focal, 1.0]) for focal in _FOCAL]
    errors = [
        [turn_error(np.linalg.inv(two @ scale) @ matrix @ one @ scale) for (one, two), matrix in flat]
        for scale in scales
    ]
    return bool((np.array(errors) < MOST_TURN).sum(1).max() >= _TURNS * len(found))


def displaced(camera: Camera, files: Sequence[Path]) -> list[str]:
    """Name those of N photographs that got the position of another one, though they show something else.

    Repeated patterns around the object, such as wallpaper, can cause this. The files are those of the cameras.
    """
    eyes, forward = Views(camera, torch.ones(len(camera), 2, 2)).eyes()
    away = torch.cdist(eyes, eyes)
    near = (away < _ONE_PLACE * away.median()) & (torch.cdist(forward, forward) < _ONE_PLACE)
    found = set()
    for one, other in near.triu(1).nonzero().tolist():
        pictures = [_small(files[row]) for row in (one, other)]
        if pictures[0].shape != pictures[1].shape or float(pictures[0] @ pictures[1]) < _ALIKE:
            found |= {files[one].name, files[other].name}
    return sorted(found)


def _small(file: Path) -> Tensor:
    """Load a small grey picture, flat, of mean 0 and length 1."""
    grey = downscale(load_reduced(file, least=_ALIKE_SIDE)[0][..., :3].mean(2)[None], _ALIKE_SIDE).flatten()
    return torch.nn.functional.normalize(grey - grey.mean(), dim=0)


def _flat(colmap: Any) -> tuple[Any, ...]:
    """Kinds of pairs that show a plane, or a pure rotation of the camera."""
    kinds = colmap.TwoViewGeometryConfiguration
    return kinds.PLANAR_OR_PANORAMIC, kinds.PANORAMIC


def reasons(colmap: Any, database: Path, photographs: Photographs, placed: Collection[str]) -> dict[str, str]:
    """Find the reason for each photograph that is not placed, and what would help, by its name."""
    usual, found = max(median(photographs.sharpness.values()), SHARP), dict(photographs.refused)
    with colmap.Database.open(database) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        features = {name: opened.num_keypoints_for_image(number) for number, name in images.items()}
        partners: dict[str, list[tuple[int, str, bool]]] = {name: [] for name in images.values()}
        flat = _flat(colmap)
        for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = (images[number] for number in colmap.pair_id_to_image_pair(pair))
            for one, other in ((first, second), (second, first)):
                partners[one].append((len(geometry.inlier_matches), other, geometry.config in flat))
        for pair, count in zip(*opened.read_num_matches(), strict=True):
            first, second = (images[number] for number in colmap.pair_id_to_image_pair(pair))
            if count > max(_FEW_MATCHES, _SAME * max(features[first], features[second])):
                partners[first].append((_FEW_MATCHES, second, True))  # matches that stay where they are were left out
                partners[second].append((_FEW_MATCHES, first, True))
    for name in photographs.names:
        if name not in placed:
            blur = photographs.sharpness[name] / usual
            found[name] = _reason(blur, features.get(name, 0), sorted(partners.get(name, ()), reverse=True), placed)
    return found


def _reason(sharpness: float, features: int, partners: list[tuple[int, str, bool]], placed: Collection[str]) -> str:
    """Say why a photograph is not placed. Partners: number of matches, name, whether depth is unknown."""
    if sharpness < BLURRED:
        return f"blurred ({round(sharpness, 1):.0%} as sharp as usual); hold still, or use more light"
    if features < 2 * _FEW_MATCHES:
        return f"only {features} features; show more of the object, or put it on a newspaper, which has texture"
    count, partner, is_flat = partners[0] if partners else (0, "", False)
    if count == 0:
        return "matches no other photograph; it shows something else, or is more than 15° away from the others"
    if count < _FEW_MATCHES:
        best = f"at most {count}, with {partner}"
        return f"too few matches ({best}); take photographs in between, at most 15° apart, without glossy surfaces"
    if is_flat:
        return f"sees what {partner} sees from the same place, or a flat thing; walk around the object"
    if partner in placed:
        return f"{count} matches with {partner}, but they do not fit the object; did it move or bend?"
    return f"matches {partner}, but both are apart from the others; take photographs in between"
