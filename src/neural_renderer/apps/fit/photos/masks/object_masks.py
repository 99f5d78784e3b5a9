"""Masks of an object in posed photographs: colours of inside and outside, and one shape for all views.

A grid of voxels around the object holds the shape. In turns, its outlines separate the colours inside from
those outside, and these colours classify voxels in all views (after Campbell et al., "Automatic 3D object
segmentation in multiple views using volumetric graph-cuts", 2010; without the graph cut). A table is recognised by what
other views show of it: what looks like that, shadows included, is no object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

from .....camera import Camera
from .....camera.files import CameraFile
from .....io import save_image
from .....io.images import load_reduced
from .....meshes.mesh import Mesh
from ....common.masks.operations import SMALL_HOLE, at_border, fill_holes, label_components, remove_specks, resize
from ....common.masks.rule import mask_beside
from ....common.views.views import Views
from ...doubts import ONE_SIDE, cameras_apart
from ..copies import IMAGES, MASKS, Progress
from ..geometry.solid import Target
from ..histogram import MOST, bins_of, histogram, log_ratio
from ..place import Place, find_place
from .background import Background
from .shape_masks import SOLID, contradiction, evidence_of_depth, masks_of_shape, shown_by_depth, write_depth
from .voxels import Voxels

_SIDE = 320  # longer side of the pictures that are compared, in pixels
_ROUNDS = 3
_WORST = 0.25, 0.12  # share of the views that decide about a voxel, first and last: those most sure of background
_FOOT = 0.04  # distance from the object, seen from above, relative to its size, up to which it may stand somewhere
_RIM = 3  # pixels inside of outlines that may still show the table
_STANDS = 1.5  # evidence of a pixel in whose direction the object may touch the ground
_RINGS = 16  # rings of the table, each half as wide as the object
_STILL = 0.06  # most difference of a still pixel from its median colour
_MOSTLY, _LEAST_STILL = 0.7, 0.15  # share of the views in which it is still, and of the picture that must be still
_MOST_BORDER = 0.1  # share of the border of a picture that an object may cover, one side left out
_MOST_CONTRADICTED = 0.05  # depth decides if it contradicts masks by colours by this share more than its own
_MOST_FILLED = 0.01  # share of masks by depth that colours fill; above it a fit starts with their hull, not the solid
_BY_DEPTH = 2 * MOST  # evidence of depth: twice what colours say at most
_BAND = 3.0  # pixels around the outline of the shape in which colours decide
_WINDOW = 7  # pixels, in which evidence follows edges
_LEAST_NOISE = 0.01  # difference of colours of a picture without noise
_ONE_SIDE = "all cameras are on one side, or the object was turned before a background that did not turn with it"
_LIKE, _OTHERWISE = 2.5, 1.5  # medians in a standard deviation of the background; evidence for it where they agree


@dataclass(frozen=True)
class FoundMasks:
    """What was found in photographs."""

    reason: str | None  # why there is no object, though masks may be written; None if one stands out
    second: float  # size of a second object that the masks leave out, relative to the first
    is_known: bool  # depth showed the object; otherwise only colours decided
    cloud: Tensor  # [P, 3], points that photographs agree on, by depth
    moved: frozenset[str] = frozenset()  # photographs that show it elsewhere, or hidden; they get no masks


def find_masks(
    cameras: CameraFile,
    folder: Path,
    progress: Progress,
    target: Target | None = None,
    files: Sequence[Path] | None = None,
) -> FoundMasks:
    """Find the masks of the object in all photographs of a model; write those that the folder ``masks`` lacks.

    Depth separates the object, and colours locate its outlines. Where depth shows too little, only colours are used.

    Args:
        cameras: The model, with points.
        folder: Folder for masks and depth.
        progress: Receives the progress.
        target: Number of a photograph, and the part of it that shows the object.
        files: The photographs; by default those in the folder ``images``.

    Returns:
        Whether one stands out, most photographs show all of it, and cameras are around it.
    """
    names = [entry.name for entry in cameras.images]
    files = files or [folder / IMAGES / name for name in names]
    images, full = _load(files)
    camera, points = cameras.cameras(full), cameras.points
    if cameras_apart(Views(camera, torch.ones(len(camera), *full))) < ONE_SIDE:
        return FoundMasks(_ONE_SIDE, 0.0, False, torch.zeros(0, 3))
    shape = masks_of_shape(images, camera, points, progress, target)
    write_depth(folder, shape, names)
    (folder / SOLID).unlink(missing_ok=True)
    if shape.masks is None and shape.is_certain:
        return FoundMasks(shape.reason, 0.0, True, shape.cloud)
    rest = np.arange(len(images)) if shape.moved is None else np.flatnonzero(~shape.moved)
    is_known = shape.masks is not None and shape.is_certain
    shown = shown_by_depth(shape, camera) if is_known else np.zeros((len(images), 1, 1), np.int8)
    ground = shape.ground if is_known else None
    place = find_place(camera, shape.cloud if points is None else points, full, ground)
    masks, second = np.zeros(images.shape[:3], bool), 0.0
    masks[rest], second = _masks_of_colors(images[rest], camera[rest], place, progress, shown[rest])
    if shape.masks is not None and is_known:
        second = shape.rivals
        wrong, usual = (contradiction(one, shown) for one in (masks, shape.masks))
        if target is not None or wrong > usual + _MOST_CONTRADICTED:
            # Depth is unknown on dark or plain parts, where a thin wall gets holes; colours show what is in these.
            holes = np.stack([ndimage.binary_fill_holes(one) for one in shape.masks]) & ~shape.masks
            filled = holes & masks
            masks = shape.masks | filled
            if shape.solid is not None and filled.sum() < _MOST_FILLED * masks.sum():
                Mesh(shape.solid.vertices, shape.solid.faces).save(folder / SOLID)
    if not masks.any():
        return FoundMasks("no object stands out in all photographs", 0.0, is_known, shape.cloud)
    for name, mask in zip((names[row] for row in rest), masks[rest], strict=True):
        clean = fill_holes(torch.from_numpy(ndimage.binary_opening(mask, iterations=1)), SMALL_HOLE).float()
        clean = remove_specks(clean) if bool(clean.any()) else clean
        smooth = torch.from_numpy(ndimage.gaussian_filter(clean.numpy(), 1.0))
        if mask_beside(folder / MASKS, Path(name).name) is None:
            save_image(folder / MASKS / f"{Path(name).name}.png", (resize(smooth[None], full)[0] > 0.5).float())
    why = None if _are_whole(masks[rest]) else "the masks found reach over the border of most photographs"
    return FoundMasks(why, second, is_known, shape.cloud, frozenset(names) - {names[row] for row in rest})


def _are_whole(masks: np.ndarray) -> bool:
    """Find whether masks [N, H, W] end within most pictures: a pillar may leave them at one side, as no wall does."""
    sides = np.stack([side.sum(1) for side in (masks[:, 0], masks[:, -1], masks[:, :, 0], masks[:, :, -1])])
    share = (sides.sum(0) - sides.max(0)) / (2 * sum(masks.shape[1:]))
    return bool(np.median(share) < _MOST_BORDER)


def _masks_of_colors(
    images: np.ndarray, camera: Camera, place: Place, progress: Progress, shown: np.ndarray
) -> tuple[np.ndarray, float]:
    """Find masks [N, H, W] by colours, all empty without an object, and the size of a second one.

    Where depth shows something, see `shown_by_depth`, it decides.
    """
    seen = Voxels(camera, place, (images.shape[1], images.shape[2]))
    background = Background(images, camera, place)
    still = _still_evidence(images) + _BY_DEPTH * evidence_of_depth(shown, images.shape[1:3])
    solid, second = seen.near(place.points) if len(place.points) else seen.ball(), 0.0
    for turn, share in enumerate(np.linspace(*_WORST, _ROUNDS)):
        progress("outlines", turn, _ROUNDS)
        outlines = seen.outlines(solid)
        known = still + _background_evidence(images, background, place, outlines, seen.points[solid])
        evidence = _evidence(images, outlines, known)
        solid, second = seen.solid(evidence, share)
        if not solid.any():
            break
    progress("outlines", _ROUNDS, _ROUNDS)
    if not solid.any():
        return np.zeros(images.shape[:3], bool), 0.0
    outlines = seen.outlines(solid)
    depth = np.stack([ndimage.distance_transform_edt(o) - ndimage.distance_transform_edt(~o) for o in outlines])
    return evidence + MOST * np.clip(depth / _BAND, -2, 2) > 0, second


def _load(files: Sequence[Path]) -> tuple[np.ndarray, tuple[int, int]]:
    """Load small pictures [N, H, W, 3]; return also the full height and width."""
    images = []
    for file in files:
        image, full = load_reduced(file, least=_SIDE)
        scale = min(1.0, _SIDE / max(image.shape[:2]))
        size = round(image.shape[0] * scale), round(image.shape[1] * scale)
        images.append(resize(image[..., :3].permute(2, 0, 1), size).permute(1, 2, 0).numpy())
    return np.stack(images), full


def _evidence(images: np.ndarray, outlines: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Compute the log-likelihood ratio [N, H, W] of each pixel's colour, inside of the outlines to outside.

    The colours of the object are those of all pictures; those outside are half of all, half of the same picture.
    """
    index = bins_of(images)
    inside = np.stack([ndimage.binary_erosion(one, iterations=2, border_value=1) for one in outlines]) & (known >= 0)
    outside = ~np.stack([ndimage.binary_dilation(one, iterations=3) for one in outlines]) | (known < -1)
    ours, all_others = histogram(index[inside]), histogram(index[outside])
    found = np.empty(index.shape, np.float32)
    for row, bins in enumerate(index):
        others = (all_others + histogram(bins[outside[row]])) / 2
        ratio = log_ratio(ours, others, bins) + known[row]
        found[row] = _follow_edges(images[row].mean(2), np.clip(ratio, -MOST, MOST))
    return found


def _follow_edges(guide: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Smooth values [H, W] except across the edges of a grey picture (He et al., "Guided Image Filtering", 2013)."""

    def mean(image: np.ndarray) -> np.ndarray:
        return ndimage.uniform_filter(image, _WINDOW)

    average, level = mean(guide), mean(values)
    slope = (mean(guide * values) - average * level) / (mean(guide * guide) - average**2 + 1e-3)
    return mean(slope) * guide + mean(level - slope * average)


def _still_evidence(images: np.ndarray) -> np.ndarray:
    """Compute the same as `_evidence` for the pixels of a background that stands still, as behind a turntable."""
    difference = np.abs(images - np.median(images, 0)).max(-1)
    pieces = label_components(torch.from_numpy((difference < _STILL).mean(0) > _MOSTLY))
    still = at_border(pieces).numpy()  # the middle of a plain object stands still, too
    if still.mean() < _LEAST_STILL:
        return np.zeros_like(difference)
    return np.where(still, np.clip(difference / _STILL * MOST - 2 * MOST, -MOST, 1.0), 0.0)


def _background_evidence(
    images: np.ndarray, background: Background, place: Place, outlines: np.ndarray, shape: np.ndarray
) -> np.ndarray:
    """Compute the log-likelihood ratio [N, H, W] against the predicted background at each pixel.

    The outlines hide it in other views. Where most pixels beside the outlines do not look as predicted, it is not
    known. The object probably stands on the table where no view shows it, below the points ``shape`` [V, 3].
    """
    likely, covered = np.zeros(images.shape[:3], np.float32), np.zeros_like(outlines)
    hidden = np.stack([ndimage.binary_erosion(one, iterations=_RIM) for one in outlines])
    colours, points = background.predict(hidden)
    change = colours - images
    smooth = ndimage.uniform_filter(np.nan_to_num(change), (0, 3, 3, 0))
    difference = np.where(np.isfinite(change), np.abs(smooth), np.nan).max(-1)
    away = np.linalg.norm(points - place.center, axis=-1) / place.half
    if place.ground is not None:
        foot = cKDTree(shape - np.outer(shape @ place.ground[:3] - place.ground[3], place.ground[:3]))
        below = np.isnan(difference) & (away < 2)
        covered[below] = foot.query(points[below])[0] < _FOOT * place.half
    valid = np.isfinite(difference)
    noise = np.array([_median(one[known]) for one, known in zip(difference, valid, strict=True)])[:, None, None]
    rings = np.minimum(np.nan_to_num(away, nan=_RINGS), _RINGS - 1).astype(int)  # a ray may never meet the table
    outside = valid & ~outlines
    usual = np.array([_median(difference[outside & (rings == ring)]) for ring in range(_RINGS)])
    likely[valid] = np.minimum(_excess(difference, noise), 0)[valid]
    likely[valid] += np.maximum(_excess(difference, np.maximum(noise, usual[rings])), 0)[valid]
    likely[covered] = _STANDS
    return likely


def _median(differences: np.ndarray) -> float:
    """Compute the median of differences, at least that of a picture without noise."""
    return max(float(np.median(differences)), _LEAST_NOISE) if len(differences) else _LEAST_NOISE


def _excess(difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Convert colour differences to log-likelihood ratios; those within 4.3 times the noise count against an object."""
    return np.clip((difference / (_LIKE * noise)) ** 2 / 2 - _OTHERWISE, -MOST, MOST)
