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
from .masks.voxels import Voxels
from .place import find_place

_WINDOW = 3  # pixels a side, over which differences are averaged
_NOISES, _LEAST = 4.0, 0.08  # difference from the background that is strange, in units of the usual one; at least
_SPECK = 2  # pixels that are eroded, so that only what is wider counts
_HIDES = 2  # pixels around an outline that may show the object, so they are no samples of the background


_MOST_PLAIN = 0.25  # largest share of the views that may see the background in a voxel of a missing part
_LEAST_STRANGE = 0.4  # least share of the views that see something strange there, among those where no mesh hides it
_HEIGHT = 0.07  # least height of such a voxel over the table, where shadows lie, relative to half the cube


@torch.no_grad()
def stands_beside(
    photos: Tensor, camera: Camera, points: Tensor, inside: np.ndarray, ground: np.ndarray | None = None
) -> float:
    """Measure the area around outlines that does not look like the background, relative to the area inside.

    Only what is strange at one place in most views counts: highlights, shadows and people change from view to view.

    Args:
        photos: Whole photographs [N, 3, H, W].
        camera: Their N cameras.
        points: [P, 3], points of the scene.
        inside: [N, H, W] bool, outlines of the mesh.
        ground: Plane [4] under the mesh, as in `find_place`.

    Returns:
        The median of all photographs, from 0: as many of them show the part that is missing.
    """
    images = photos.permute(0, 2, 3, 1).cpu().numpy()
    hidden = np.stack([ndimage.binary_dilation(one, iterations=_HIDES) for one in inside])
    place = find_place(camera, points, inside.shape[1:3], ground)
    background = predict_background(images, camera, place, hidden)
    known = np.isfinite(background).all(3) & ~inside
    strange = np.stack([_strange(*one) for one in zip(images, background, known, strict=True)])
    voxels = Voxels(camera, place, inside.shape[1:3])
    wide = np.stack([ndimage.binary_dilation(one) for one in strange]) & ~inside
    plain, odd, ours = (voxels.values(part).sum(0) for part in (known & ~wide, wide, inside))
    missing = (odd > 1) & (plain <= _MOST_PLAIN * (plain + odd)) & (odd >= _LEAST_STRANGE * (voxels.shown - ours))
    if place.ground is not None:
        missing &= voxels.points @ place.ground[:3] - place.ground[3] > _HEIGHT * place.half
    found = voxels.outlines(missing) & strange & ~hidden
    shares = [one.sum() / mask.sum() for one, mask in zip(found, inside, strict=True) if mask.any()]
    return float(np.median(shares)) if shares else 0.0


def _strange(image: np.ndarray, background: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Mark the known pixels of one photograph [H, W, 3] that differ from the background."""
    if not known.any():
        return known
    change = np.where(known[..., None], background * gain(background[known], image[known]) - image, 0.0)
    difference = np.abs(ndimage.uniform_filter(change, (_WINDOW, _WINDOW, 0))).max(2)
    strange = known & (difference > max(_NOISES * float(np.median(difference[known])), _LEAST))
    return np.asarray(ndimage.binary_opening(strange, iterations=_SPECK))
