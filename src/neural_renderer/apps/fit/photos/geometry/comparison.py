"""Comparison of the depth of photographs with a mesh, and photographs in which the object is elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from torch import Tensor

from .....camera import Camera
from .....raster.fragments import Fragments
from ....common.views.views import Views
from .depth import DepthMaps, confirmed_by, pixels_of, places_of, supported

NEAR = 0.03
"""Distance from a mesh of points that it explains, relative to its longest side."""
_RIM = 2  # width in pixels of the rim of a drawing that does not count
_MOST_AGAINST = 0.2  # share of the pixels with depth that contradict a mesh, from which the object is elsewhere
_LEAST_PIXELS = 50  # with depth
_MOST_MOVED = 0.4  # share of the photographs; if more contradict it, the mesh itself may be wrong
_POINTS = 500  # points of a photograph that are compared with the others
_AROUND = 0.6  # distance of these from the middle of the mesh along each axis, relative to its longest side
_LEAST_PAIR = 30  # of these in a photograph where it has depth
_LEAST_GROUP = 3  # photographs that show the object in one place
_MOST_PLACES = 3  # of the object
_SEEN_THROUGH, _TIMES = 0.2, 2.0  # mean share between places, and relative to that within one, to be several


@dataclass(frozen=True)
class Scaled:
    """N views, their depth and a mesh, moved to the origin and scaled to a longest side of 1."""

    views: Views
    maps: DepthMaps
    shape: tuple[Tensor, Tensor]  # vertices and faces
    center: Tensor  # [3], centre of the mesh before
    side: float  # its longest side before


@dataclass(frozen=True)
class Compared:
    """Drawing of a mesh with longest side 1 in one view, and its depth there."""

    drawn: Fragments
    core: Tensor  # [H, W] bool, inside of its outline
    has: Tensor  # [H, W] bool, where that has depth
    behind: Tensor  # [H, W], how far the view's depth is behind the mesh
    error: Tensor  # [H, W], error of that


def scaled(camera: Camera, maps: DepthMaps, vertices: Tensor, faces: Tensor) -> Scaled:
    """Scale N views with depth and a mesh in the world of their cameras."""
    low, high = vertices.amin(0), vertices.amax(0)
    center, side = (low + high) / 2, float((high - low).max())
    views = Views(camera, torch.ones_like(maps.depth)).normalized(center, side)
    return Scaled(views, replace(maps, depth=maps.depth / side), ((vertices - center) / side, faces), center, side)


@torch.no_grad()
def compare_depth(scene: Scaled) -> Iterator[Compared]:
    """Compare the depth of views with a mesh, one view after the other."""
    maps, known, (eyes, forward) = scene.maps, supported(scene.maps), scene.views.eyes()
    for row in range(len(scene.views)):
        drawn = scene.views[[row]].fragments(scene.shape, anti_aliasing=False)
        depth = drawn.interpolate(((scene.shape[0] - eyes[row]) * forward[row]).sum(1, keepdim=True))[0, ..., 0]
        core = torch.from_numpy(ndimage.binary_erosion(drawn.mask[0].numpy(), iterations=_RIM))
        error = torch.clamp(2 * maps.error[row] * maps.depth[row], min=NEAR)
        yield Compared(drawn, core, core & known[row], maps.depth[row] - depth, error)


def moved(
    camera: Camera, maps: DepthMaps, vertices: Tensor, faces: Tensor, ground: np.ndarray | None = None
) -> np.ndarray:
    """Find the photographs [N] bool that show an object elsewhere than most others: by their depth, and a mesh of it.

    Between these and the others, the object was moved or turned on its table; or something hides it there. A mesh of
    half of them may be both objects in one, so photographs are compared with each other first; of equal places, the
    first photograph's counts. Otherwise those contradict the mesh, and none if they are many. Points over the plane
    ``ground`` [4] that the others found, too, are at rest: there the mesh is wrong, not the photograph.
    """
    scene = scaled(camera, maps, vertices, faces)
    places = split_in_places(_seen_through(scene, ground))
    if places is not None:
        return places != places[np.bincount(places)[places].argmax()]
    against, number = [], []
    for one in compare_depth(scene):
        against.append(one.has & (one.behind.abs() > 2 * one.error))
        number.append(int(one.has.sum()))
    counts, most = np.array(number), _MOST_AGAINST * np.array(number)
    found = (counts >= _LEAST_PIXELS) & (np.array([int(one.sum()) for one in against]) > most)
    if ground is not None:
        rest = torch.from_numpy(~found)
        for row in np.flatnonzero(found):
            confirmed = confirmed_by(scene.views, scene.maps, int(row), rest)
            place = places_of(scene.views, scene.maps, int(row)) * scene.side + scene.center
            is_above = place @ torch.from_numpy(ground[:3]).float() - ground[3] > 2 * NEAR * scene.side
            found[row] = int((against[row] & ~(confirmed & is_above)).sum()) > most[row]
    return found & (np.mean(found) <= _MOST_MOVED)


def _seen_through(scene: Scaled, ground: np.ndarray | None) -> np.ndarray:
    """Measure how many of the points that one view shows around the mesh another sees through: [N, N], NaN if few."""
    known, size = supported(scene.maps), (scene.maps.depth.shape[1], scene.maps.depth.shape[2])
    # At an edge a pixel may show what is behind it, so the nearest depth around each counts.
    near = -F.max_pool2d(-torch.where(known, scene.maps.depth, torch.inf)[:, None], 3, 1, 1)[:, 0]
    near = torch.where(known, near, torch.nan)
    error = torch.clamp(2 * scene.maps.error[:, None, None] * near, min=NEAR)
    found = np.full((len(known), len(known)), np.nan)
    for row in range(len(known)):
        points = places_of(scene.views, scene.maps, row)[known[row]]
        chosen = points.abs().amax(1) < _AROUND
        if ground is not None:
            normal = torch.from_numpy(ground[:3]).to(points)
            chosen &= (scene.side * points + scene.center) @ normal - ground[3] > NEAR * scene.side
        points = points[chosen]
        points = points[:: max(1, len(points) // _POINTS)]
        if not len(points):
            continue
        pixel, inside, depth = pixels_of(scene.views.camera, points, size)
        behind, limit = (part.flatten(1).gather(1, pixel) for part in (near, error))
        has = inside & torch.isfinite(behind)
        number = has.sum(1).numpy()
        share = (has & (behind - depth > 2 * limit)).sum(1).numpy() / np.maximum(number, 1)
        found[row] = np.where(number >= _LEAST_PAIR, share, np.nan)
    np.fill_diagonal(found, np.nan)
    return np.fmax(found, found.T)


def split_in_places(contradiction: np.ndarray) -> np.ndarray | None:
    """Number N photographs by the place [N] in which they show an object; None if it has one place.

    Those of one place contradict each other [N, N] less than those of others. The largest part is cut again as long as
    that is not so.
    """
    known, places = np.isfinite(contradiction), np.zeros(len(contradiction), np.int64)
    for number in range(1, _MOST_PLACES):
        rows = np.flatnonzero(places == np.bincount(places).argmax())
        places[rows[_best_cut(contradiction[np.ix_(rows, rows)])]] = number
        same = places[:, None] == places
        is_split = np.bincount(places, minlength=number + 1).min() >= _LEAST_GROUP
        if not (is_split and (known & same).any() and (known & ~same).any()):
            return None
        within, between = contradiction[known & same].mean(), contradiction[known & ~same].mean()
        if between > max(_SEEN_THROUGH, _TIMES * within):
            return places
    return None


def _best_cut(contradiction: np.ndarray) -> np.ndarray:
    """Split N photographs in two parts [N] bool, of the largest sum of contradictions [N, N] between them.

    Contradictions are relative to the mean of all. The eigenvector of the least eigenvalue comes first, then single
    photographs are moved.
    """
    known = np.isfinite(contradiction)
    if not known.any():
        return np.zeros(len(known), bool)
    excess = np.where(known, contradiction - contradiction[known].mean(), 0.0)
    side = np.where(np.linalg.eigh(excess)[1][:, 0] > 0, 1.0, -1.0)
    while (gain := side * (excess @ side)).max() > np.finfo(np.float32).eps:  # each step raises the sum
        side[gain.argmax()] *= -1
    return np.asarray(side > 0)
