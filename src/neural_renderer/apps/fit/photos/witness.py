"""What photographs say of a mesh, apart from masks that were found in them.

Their depth was found without masks, by windows that look alike in three views or more. It shows which parts of a mesh
are where views see something, which parts views see through, and what stands there that the mesh lacks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

from ....camera import Camera
from ...common.views.views import Views
from .geometry.depth import DepthMaps
from .geometry.solid import cloud_of, label_pieces, supported, with_hanging

_NEAR = 0.03  # distance from a mesh, relative to its longest side, of points that it explains
_THROUGH = 2.0  # the same distance behind a mesh, in units of that, from which a view sees through it
_REACH = 1.2  # radius around a mesh in which points are searched, relative to its longest side
_CELL = 0.04  # side of the cells in which points are connected, relative to the same
_ABOVE = 0.03  # height over the plane of what stands on it, relative to the same
_RIM = 2  # pixels inside of outlines that do not count
_MOST_SAMPLES = 60_000
_OWN = 0.2  # share of the points of a piece near a mesh, from which the piece belongs to it


@dataclass(frozen=True)
class Witness:
    """Shares in [0, 1] that photographs say of a mesh."""

    explained: float  # of the points that stand where the mesh does: those near it
    confirmed: float  # of the pixels that show the mesh: those in which at least three views found it there
    seen_through: float  # of the pixels that show the mesh and have depth: those with something far behind it


@torch.no_grad()
def ask(vertices: Tensor, faces: Tensor, camera: Camera, maps: DepthMaps, ground: np.ndarray | None) -> Witness:
    """Compare a mesh with the depth of N views, on a plane or without one.

    Args:
        vertices, faces: The mesh in the world of the cameras.
        camera: The N cameras.
        maps: Depth of their views.
        ground: [4], plane (n, d) under the mesh, n upwards; or None.
    """
    low, high = vertices.amin(0), vertices.amax(0)
    center, side = (low + high) / 2, float((high - low).max())
    size = maps.depth.shape[1], maps.depth.shape[2]
    views = Views(camera, torch.ones(len(camera), *size)).normalized(center, side)
    shape = (vertices - center) / side, faces
    near = replace(maps, depth=maps.depth / side)
    confirmed, through, known = 0, 0, 0
    covered, ways = 0, views.eyes()[1]
    for row in range(len(views)):
        seen = views[[row]].fragments(shape, anti_aliasing=False)
        depth = seen.interpolate(((shape[0] - views.eyes()[0][row]) * ways[row]).sum(1, keepdim=True))[0, ..., 0]
        inside = torch.from_numpy(ndimage.binary_erosion(seen.mask[0].numpy(), iterations=_RIM))
        has = inside & supported(near)[row]
        behind = near.depth[row] - depth
        error = torch.clamp(2 * near.error[row] * near.depth[row], min=_NEAR)
        covered, known = covered + int(inside.sum()), known + int(has.sum())
        confirmed += int((has & (behind.abs() < error)).sum())
        through += int((has & (behind > _THROUGH * error)).sum())
    plane = None if ground is None else np.append(ground[:3], (ground[3] - center.double().numpy() @ ground[:3]) / side)
    explained = _explained(shape, cloud_of(views, near), plane)
    return Witness(explained, confirmed / max(covered, 1), through / max(known, 1))


def _explained(shape: tuple[Tensor, Tensor], cloud: Tensor, ground: np.ndarray | None) -> float:
    """Compute the share near a mesh among the points [P, 3] of what it belongs to; 1 without any.

    The longest side of the mesh is 1, and its box is around the origin.
    """
    cloud = cloud[cloud.norm(dim=1) < _REACH]
    points = cloud[:: max(1, len(cloud) // _MOST_SAMPLES)].double().numpy()
    if ground is not None:
        points = points[points @ ground[:3] - ground[3] > _ABOVE]
    own = label_pieces(points, np.zeros(3), _REACH, _CELL)
    if not own.any():
        return 1.0
    corners = shape[0][shape[1]]
    samples = torch.cat((corners.mean(1), corners.roll(1, 1).add(corners).div(2).flatten(0, 1)))
    is_near = cKDTree(samples.double().numpy()).query(points)[0] < _NEAR
    near, number = np.bincount(own, is_near), np.bincount(own)
    near[0], number[0] = 0, 1
    pieces = sorted({int(near.argmax()), *np.flatnonzero(near > _OWN * number).tolist()})
    return float(is_near[np.isin(own, with_hanging(points, own, pieces, ground, _REACH))].mean())
