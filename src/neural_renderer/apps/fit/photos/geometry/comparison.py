"""Comparison of the depth of photographs with a mesh, and photographs in which the object is elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from .....camera import Camera
from .....raster.fragments import Fragments
from ....common.views.views import Views
from .depth import DepthMaps, supported

NEAR = 0.03
"""Distance from a mesh of points that it explains, relative to its longest side."""
_RIM = 2  # width in pixels of the rim of a drawing that does not count
_MOST_AGAINST = 0.2  # share of the pixels with depth that contradict a mesh, from which the object is elsewhere
_LEAST_PIXELS = 50  # with depth
_MOST_MOVED = 0.4  # share of the photographs; if more contradict it, the mesh itself may be wrong


@dataclass(frozen=True)
class Compared:
    """Drawing of a mesh with longest side 1 in one view, and its depth there."""

    drawn: Fragments
    core: Tensor  # [H, W] bool, inside of its outline
    has: Tensor  # [H, W] bool, where that has depth
    behind: Tensor  # [H, W], how far the view's depth is behind the mesh
    error: Tensor  # [H, W], error of that


@torch.no_grad()
def compare_depth(camera: Camera, maps: DepthMaps, vertices: Tensor, faces: Tensor) -> Iterator[Compared]:
    """Compare the depth of N views with a mesh in the world of the cameras, one view after the other."""
    low, high = vertices.amin(0), vertices.amax(0)
    center, side = (low + high) / 2, float((high - low).max())
    views = Views(camera, torch.ones_like(maps.depth)).normalized(center, side)
    shape, known, (eyes, forward) = ((vertices - center) / side, faces), supported(maps), views.eyes()
    for row in range(len(views)):
        drawn = views[[row]].fragments(shape, anti_aliasing=False)
        depth = drawn.interpolate(((shape[0] - eyes[row]) * forward[row]).sum(1, keepdim=True))[0, ..., 0]
        core = torch.from_numpy(ndimage.binary_erosion(drawn.mask[0].numpy(), iterations=_RIM))
        seen = maps.depth[row] / side
        error = torch.clamp(2 * maps.error[row] * seen, min=NEAR)
        yield Compared(drawn, core, core & known[row], seen - depth, error)


def moved(camera: Camera, maps: DepthMaps, vertices: Tensor, faces: Tensor) -> np.ndarray:
    """Find the photographs [N] bool whose depth contradicts a mesh; none if they are many.

    Between these and the others, the object was moved or turned on its table; or something hides it there.
    """
    found = []
    for one in compare_depth(camera, maps, vertices, faces):
        against, number = int((one.has & (one.behind.abs() > 2 * one.error)).sum()), int(one.has.sum())
        found.append(number >= _LEAST_PIXELS and against > _MOST_AGAINST * number)
    return np.array(found) & (np.mean(found) <= _MOST_MOVED)
