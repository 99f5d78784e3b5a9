"""Colours of the background behind an object, from other photographs that see it past the object.

There are two layers: the table, a plane as far as it reaches, and what is behind it, such as a wall or a floor below.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from .....camera import Camera
from ....common.views.views import Views
from ..geometry.sweep import rays_of
from ..place import Place

_OTHERS = 24  # views that predict the background of one, about; of more, every second one, third one, …
_LEAST_POINTS = 10  # least number of points behind the table that determine its depth in a view
_ALIKE = 5  # neighbours in a view whose median depth a point gets, because some points are errors
_REACH, _CELLS = 8, 128  # part of the table that has a map, in halves of the object, and its cells along each side


def predict_background(images: np.ndarray, camera: Camera, place: Place, hidden: np.ndarray) -> np.ndarray:
    """Predict the colours [N, H, W, 3] of the background behind each pixel; NaN where no view shows it.

    They are the median of the colours of other views at the point where the pixel's ray meets the background.

    Args:
        images: Photographs [N, H, W, 3].
        camera: Their N cameras.
        place: Place of the object, with the plane of the table and the points around.
        hidden: [N, H, W] bool: what hides the background, such as outlines of the object.
    """
    return Background(images, camera, place).predict(hidden)[0]


def gain(background: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """Compute the factor [3] from the exposure of a background to that of its photograph, from P pixels [P, 3]."""
    if not len(photo):
        return np.ones(3, np.float32)
    return np.asarray(np.median(photo, axis=0) / np.maximum(np.median(background, axis=0), 1e-3))


class Background:
    """The background in N photographs [N, H, W, 3]."""

    def __init__(self, images: np.ndarray, camera: Camera, place: Place) -> None:
        self._images, self._camera, self._place = images, camera, place
        size, count = (images.shape[1], images.shape[2]), len(images)
        eyes = Views(camera, torch.ones(count, 2, 2)).eyes()[0]
        order = torch.cdist(eyes, eyes).argsort(1)[:, 1:].tolist()
        self._others = [near[:: max(1, round(len(near) / _OTHERS))] for near in order]
        self.table = np.full((count, *size, 3), np.nan)  # where each ray meets the plane; NaN where it does not
        if place.ground is not None:
            self.table = np.stack([_meet(camera[row : row + 1], place.ground, size) for row in range(count)])
        self._behind = [_points_behind(camera[row : row + 1], place.around, size) for row in range(count)]

    def predict(self, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predict the colours [N, H, W, 3], and the points of the background that have them; NaN where unknown."""
        points = self.table.copy()
        colours = self._seen(points, hidden)
        rows = [row for row, behind in enumerate(self._behind) if behind is not None]
        if not rows:
            return colours, points
        behind = np.full_like(points, np.nan)
        behind[rows] = [self._behind[row] for row in rows]
        others = self._seen(behind, hidden)
        is_behind = self._is_behind(colours, others, hidden)
        colours[is_behind], points[is_behind] = others[is_behind], behind[is_behind]
        return colours, points

    def _seen(self, points: np.ndarray, hidden: np.ndarray) -> np.ndarray:
        """Compute the median colours [N, H, W, 3] that other views show of points [N, H, W, 3], one for each pixel."""
        size = points.shape[1:3]
        layers = np.concatenate((self._images, hidden[..., None]), 3, dtype=np.float32)
        seeing = torch.from_numpy(layers).permute(0, 3, 1, 2)
        found = np.full(points.shape, np.nan, np.float32)
        for row, others in enumerate(self._others):
            known = np.isfinite(points[row, ..., 0])
            if not known.any():
                continue
            places = torch.from_numpy(points[row][known]).float()
            pixels, depth = self._camera[others].project(places.expand(len(others), -1, -1), size)
            grid = pixels / pixels.new_tensor([size[1], size[0]]) * 2 - 1
            seen = F.grid_sample(seeing[others], grid[:, None], align_corners=False)[:, :, 0]
            shown = (depth > 0) & (grid.abs() < 1).all(-1) & (seen[:, 3] < 0.5)
            median = torch.where(shown[:, None], seen[:, :3], torch.nan).nanmedian(0).values
            found[row][known] = median.T.numpy()
        return found

    def _is_behind(self, table: np.ndarray, behind: np.ndarray, hidden: np.ndarray) -> np.ndarray:
        """Mark the pixels [N, H, W] that show the layer behind the table, by comparing the predictions of both.

        All views decide together where the table ends: a part of it exists if they look more like it on average.
        """
        is_table = np.isfinite(self.table[..., 0])
        if self._place.ground is None or not is_table.any():
            return np.isfinite(behind[..., 0])
        worse = np.abs(behind - self._images).max(-1) - np.abs(table - self._images).max(-1)
        votes = is_table & ~hidden & np.isfinite(table[..., 0]) & np.isfinite(behind[..., 0])
        axes = np.linalg.svd(self._place.ground[None, :3])[2][1:]
        flat = (self.table[is_table] - self._place.center) @ axes.T / (self._place.half * _REACH)
        index = np.clip((flat + 1) / 2 * _CELLS, 0, _CELLS - 1).astype(np.int64)
        cells = np.zeros(is_table.shape, np.int64)
        cells[is_table] = index[:, 0] * _CELLS + index[:, 1]
        ends = np.bincount(cells[votes], worse[votes], minlength=_CELLS**2) < 0
        return np.where(is_table, ends[cells], True) & np.isfinite(behind[..., 0])


def _meet(camera: Camera, ground: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Compute where each pixel's ray of one camera meets the plane ``ground`` [4]: [H, W, 3], NaN where it does not."""
    eye, ray = (part.double().numpy() for part in rays_of(camera, size))
    with np.errstate(divide="ignore"):
        depth = (ground[3] - eye @ ground[:3]) / (ray @ ground[:3])
    return eye + np.where((depth > 0) & np.isfinite(depth), depth, np.nan)[..., None] * ray


def _points_behind(camera: Camera, around: np.ndarray, size: tuple[int, int]) -> np.ndarray | None:
    """Interpolate the inverse depth of points around between the pixels of one view; returns points [H, W, 3]."""
    pixels, depth = (part[0].double().numpy() for part in camera.project(torch.from_numpy(around).float(), size))
    shown = (depth > 0) & (pixels > 0).all(1) & (pixels < [size[1], size[0]]).all(1)
    if shown.sum() < _LEAST_POINTS:
        return None
    pixels, inverse = pixels[shown], 1 / depth[shown]
    inverse = np.median(inverse[cKDTree(pixels).query(pixels, _ALIKE)[1]], axis=1)
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    found = LinearNDInterpolator(pixels, inverse)(x, y)
    found = np.where(np.isfinite(found), found, NearestNDInterpolator(pixels, inverse)(x, y))
    eye, ray = (part.double().numpy() for part in rays_of(camera, size))
    return eye + ray / found[..., None]
