"""Areas of whole photographs, outside the outline of the mesh, that do not look like the background.

A part that the mesh lacks hides the background there, so the photograph differs from what other views show behind it.
No mask is used.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from ....camera import Camera
from .masks.background import gain, predict_background
from .place import find_place

_RIM = 3  # width in pixels of the outline, which is left out
_REACH = 0.35  # width of the area around it, relative to the root of its area
_WINDOW = 3  # pixels a side, over which differences are averaged
_NOISES, _LEAST = 4.0, 0.08  # difference from the background that is strange, in units of the usual one; at least
_SPECK = 2  # pixels that are eroded, so that only what is wider counts
_HIDES = 2  # pixels around an outline that may show the object, so they are no samples of the background


@torch.no_grad()
def stands_beside(photos: Tensor, camera: Camera, points: Tensor, inside: np.ndarray) -> float:
    """Measure the area around outlines that does not look like the background, relative to the area inside.

    Args:
        photos: Whole photographs [N, 3, H, W].
        camera: Their N cameras.
        points: [P, 3], points of the scene.
        inside: [N, H, W] bool, outlines of the mesh.

    Returns:
        The median of all photographs, from 0: as many of them show the part that is missing. What is strange far from
        the outlines, where the background is not known well, is subtracted.
    """
    images = photos.permute(0, 2, 3, 1).cpu().numpy()
    hidden = np.stack([ndimage.binary_dilation(one, iterations=_HIDES) for one in inside])
    background = predict_background(images, camera, find_place(camera, points, inside.shape[1:3]), hidden)
    found = [_beside(*one) for one in zip(images, background, inside, strict=True) if one[2].any()]
    return float(np.median(found)) if found else 0.0


def _beside(image: np.ndarray, background: np.ndarray, inside: np.ndarray) -> float:
    """Measure the same in one photograph [H, W, 3]."""
    known = np.isfinite(background).all(2)
    around = known & ~inside
    if not around.any():
        return 0.0
    change = np.where(known[..., None], background * gain(background[around], image[around]) - image, 0.0)
    difference = np.abs(ndimage.uniform_filter(change, (_WINDOW, _WINDOW, 0))).max(2)
    strange = known & (difference > max(_NOISES * float(np.median(difference[around])), _LEAST))
    strange = ndimage.binary_opening(strange, iterations=_SPECK)
    area, distance = float(inside.sum()), ndimage.distance_transform_edt(~inside)
    near, far = (distance > _RIM) & (distance < _REACH * area**0.5), distance >= _REACH * area**0.5
    usual = float(strange[far].mean()) if far.any() else 0.0
    return max(float(strange[near].sum()) - usual * float(near.sum()), 0.0) / area
