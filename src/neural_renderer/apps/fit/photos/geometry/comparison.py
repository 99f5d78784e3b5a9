"""Comparison of the depth of photographs with a mesh, and photographs in which the object is elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from .....camera import Camera
from .....raster.fragments import Fragments
from ....common.views.views import Views
from .depth import DepthMaps, confirmed_by, places_of, supported

NEAR = 0.03
"""Distance from a mesh of points that it explains, relative to its longest side."""
_RIM = 2  # width in pixels of the rim of a drawing that does not count
_MOST_AGAINST = 0.2  # share of the pixels with depth that contradict a mesh, from which the object is elsewhere
_LEAST_PIXELS = 50  # with depth
_MOST_MOVED = 0.4  # share of the photographs; if more contradict it, the mesh itself may be wrong


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
    """Find the photographs [N] bool whose depth contradicts a mesh; none if they are many.

    Between these and the others, the object was moved or turned on its table; or something hides it there. Points over
    the plane ``ground`` [4] that the others found, too, are at rest: there the mesh is wrong, not the photograph.
    """
    scene = scaled(camera, maps, vertices, faces)
    against, number = [], []
    for one in compare_depth(scene):
        against.append(one.has & (one.behind.abs() > 2 * one.error))
        number.append(int(one.has.sum()))
    counts, least = np.array(number), np.maximum(_MOST_AGAINST * np.array(number), 1)
    found = (counts >= _LEAST_PIXELS) & (np.array([int(one.sum()) for one in against]) > least)
    if ground is not None:
        rest = torch.from_numpy(~found)
        for row in np.flatnonzero(found):
            confirmed = confirmed_by(scene.views, scene.maps, int(row), rest)
            place = places_of(scene.views, scene.maps, int(row)) * scene.side + scene.center
            is_above = place @ torch.from_numpy(ground[:3]).float() - ground[3] > 2 * NEAR * scene.side
            found[row] = int((against[row] & ~(confirmed & is_above)).sum()) > least[row]
    return found & (np.mean(found) <= _MOST_MOVED)
