"""Grid of voxels around an object, which all photographs see."""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage

from .....camera import Camera
from ..histogram import MOST
from ..place import Place

_CELLS = 72  # voxels along each axis
_NEAR = 1 / 8  # distance from points of the object, relative to its cube's side, up to which voxels are tried first
_SMOOTH = 0.7  # voxels by which evidence is smoothed


class Voxels:
    """Grid of voxels around an object, with the pixel of each one in N pictures."""

    def __init__(self, camera: Camera, place: Place, size: tuple[int, int]) -> None:
        line = (np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1
        grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
        points = grid * place.half + place.center
        self.points, self._place, self._size = points, place, size
        self._free = np.ones(len(points), bool)
        if place.ground is not None:
            self._free = points @ place.ground[:3] > place.ground[3]
        pixels, depth = camera.project(torch.from_numpy(points).float(), size)
        x, y = pixels[..., 0].floor().int().numpy(), pixels[..., 1].floor().int().numpy()
        shown = (depth.numpy() > 0) & (x >= 0) & (y >= 0) & (x < size[1]) & (y < size[0])
        self._pixel = np.where(shown, y * size[1] + x, -1).astype(np.int32)
        self.shown = shown.sum(0)  # [V], number of the pictures that show a voxel
        spacing = float(torch.linalg.norm(pixels[:, 1] - pixels[:, 0], dim=-1).median())
        self._gap = int(np.ceil(spacing)) + 1

    def near(self, points: np.ndarray) -> np.ndarray:
        """Mark the voxels [V] near points of the object."""
        cells = np.floor(((points - self._place.center) / self._place.half + 1) / 2 * _CELLS).astype(int)
        cells = cells[((cells >= 0) & (cells < _CELLS)).all(1)]
        marked = np.ones((_CELLS,) * 3, bool)
        marked[tuple(cells.T)] = False
        grown = ndimage.distance_transform_edt(marked) < _NEAR * _CELLS
        return ndimage.binary_fill_holes(grown).reshape(-1) & self._free

    def ball(self) -> np.ndarray:
        """Mark the voxels [V] of a ball."""
        distance = np.linalg.norm(self.points - self._place.center, axis=1)
        return (distance < self._place.half / 2) & self._free

    def values(self, images: np.ndarray) -> np.ndarray:
        """Look up what pictures [N, H, W] bool show of each voxel: [N, V], False outside of a picture."""
        flat = images.reshape(len(images), -1)
        return np.stack([(pixel >= 0) & one[pixel] for one, pixel in zip(flat, self._pixel, strict=True)])

    def outlines(self, solid: np.ndarray) -> np.ndarray:
        """Draw the outlines [N, H, W] of marked voxels."""
        found = np.zeros((len(self._pixel), self._size[0] * self._size[1]), bool)
        for row, pixel in enumerate(self._pixel[:, solid]):
            found[row, pixel[pixel >= 0]] = True
        shaped = np.pad(found.reshape(len(found), *self._size), [(0, 0)] + [(self._gap, self._gap)] * 2)
        return np.stack([_closed(one, self._gap) for one in shaped])[:, self._gap : -self._gap, self._gap : -self._gap]

    def solid(self, evidence: np.ndarray, share: float) -> tuple[np.ndarray, float]:
        """Mark the largest piece of the voxels [V] that are inside by the evidence [N, H, W] of all views.

        Those views decide that see a voxel as background most clearly: this share of all. Returns also the size of the
        second piece, relative to the first.
        """
        flat = evidence.reshape(len(evidence), -1)
        values = np.empty((len(flat), int(self._free.sum())), np.float32)
        for row, pixel in enumerate(self._pixel[:, self._free]):
            values[row] = np.where(pixel >= 0, flat[row][pixel], 0.0)
        worst = max(1, round(share * len(values)))
        score = np.full(self._free.shape, -MOST, np.float32)
        score[self._free] = np.partition(values, worst - 1, axis=0)[:worst].mean(0) + 0.5 * values.mean(0)
        inside = ndimage.gaussian_filter(score.reshape((_CELLS,) * 3), _SMOOTH) > 0
        label, count = ndimage.label(inside)
        if not count:
            return np.zeros(len(score), bool), 0.0
        sizes = np.bincount(label.ravel())[1:]
        second = float(np.sort(sizes)[-2] / sizes.max()) if count > 1 else 0.0
        return (label == 1 + np.argmax(sizes)).reshape(-1) & self._free, second


def _closed(mask: np.ndarray, radius: int) -> np.ndarray:
    """Close the gaps of a mask [H, W] by a disc: its dilation, then erosion; distances are faster than large discs."""
    grown = ndimage.distance_transform_edt(~mask) <= radius if mask.any() else mask
    return grown if grown.all() else ndimage.distance_transform_edt(grown) > radius
