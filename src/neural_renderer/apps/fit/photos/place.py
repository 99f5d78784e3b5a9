"""Place and size of the object: what all cameras look at, without the table or floor that it stands on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ....camera import Camera
from ...common.views.views import Views, view_center

SHARE = 0.8
"""Share of the pictures that must show a point of the object."""
_TRIALS = 1500  # planes that are tried: one of 15 % of the points is missed in 1 of 150 searches
_SAMPLE = 3000  # most points from which the plane is estimated
_FARTHER = 3.0  # radius of the second search, for a plane that the object hides, relative to the first
_UNDER = 1.5  # largest height of the focus over that plane, relative to the first radius
_CELLS = 32  # cells along that radius; in the second search, each occupied cell counts once
FLAT = 0.015
"""Distance of points from the plane they lie in, relative to the radius of the search."""
_LEAST_POINTS, _LEAST_SHARE = 20, 0.15  # points of a table, at least, and their share of all points
_ABOVE = 2 / 3  # share of the cameras above the table; those of an object in hands may be below
_MOST_BELOW = 0.05  # share of the points that may lie below a table, by error
_TAIL = 0.04  # share of the points on each side that are left out as errors
_APART = 1.5  # distance of the surroundings from the middle, in halves of the object's cube
_LARGER = 1.3  # size of the object relative to that of its points, because smooth parts have none
_OUTLYING = 4.0  # median distances from the middle, beyond which a point is not the object's


@dataclass(frozen=True)
class Place:
    """Place of an object in the world of the cameras."""

    center: np.ndarray  # [3] float64, centre of a cube around it
    half: float  # half the side of the cube
    ground: (
        np.ndarray | None
    )  # [4] float64, (n, d) of the plane n · X = d under it, with the unit normal n upwards; or None
    points: np.ndarray  # [P, 3] float64, points of the object
    around: np.ndarray  # [Q, 3] float64, points of what is behind object and table


def find_place(camera: Camera, points: Tensor, size: tuple[int, int], ground: np.ndarray | None = None) -> Place:
    """Find the object from N cameras and points [P, 3] of the scene; ``size`` is that of the pictures.

    The plane [4] under it is searched if it is not given.
    """
    views = Views(camera, torch.ones(len(camera), *size))
    focus, reach = view_center(views)
    eyes, scene = views.eyes()[0].double().numpy(), points.double().numpy()
    around = scene[np.linalg.norm(scene - focus.double().numpy(), axis=1) < reach]
    pixels, depth = camera.project(torch.from_numpy(around).float(), size)
    inside = (depth > 0) & (pixels > 0).all(-1) & (pixels[..., 0] < size[1]) & (pixels[..., 1] < size[0])
    ground = find_ground(scene, eyes, focus.double().numpy(), reach) if ground is None else ground
    shown = inside.float().mean(0).numpy() >= SHARE
    if ground is not None:
        shown &= around @ ground[:3] - ground[3] > 2 * FLAT * reach
    found = around[shown]
    if len(found) < _LEAST_POINTS:
        return Place(focus.double().numpy(), reach / 3, ground, found, np.zeros((0, 3)))
    # Around the focus, where the object is, most points are its own.
    distance = np.linalg.norm(found - np.median(found, 0), axis=1)
    found = found[distance < _OUTLYING * np.median(distance)]
    feet = found if ground is None else found - np.outer(found @ ground[:3] - ground[3], ground[:3])
    low, high = np.quantile(np.concatenate((found, feet)), [_TAIL / 2, 1 - _TAIL / 2], axis=0)
    center, half = (low + high) / 2, _LARGER * float((high - low).max()) / 2
    others = np.abs(scene - center).max(1) > _APART * half
    if ground is not None:
        others &= np.abs(scene @ ground[:3] - ground[3]) > 2 * FLAT * reach
    return Place(center, half, ground, found, scene[others])


def find_ground(
    points: np.ndarray, eyes: np.ndarray, focus: np.ndarray, reach: float, sparse: np.ndarray | None = None
) -> np.ndarray | None:
    """Find the plane [4] that most points around the focus lie in, most cameras above and hardly a point below.

    Where the object fills the pictures, or the plane has few features, it is searched farther away, in the sparse
    points if there are any, because they are more accurate there. Returns None without a plane.
    """
    plane = _most_of(points[np.linalg.norm(points - focus, axis=1) < reach], eyes, FLAT * reach)
    if plane is not None:
        return plane
    radius = _FARTHER * reach
    far = points if sparse is None else sparse
    far = far[np.linalg.norm(far - focus, axis=1) < radius]
    far = far[np.unique(np.floor(far / (radius / _CELLS)), axis=0, return_index=True)[1]]
    plane = _most_of(far, eyes, FLAT * radius)
    return plane if plane is not None and 0 < focus @ plane[:3] - plane[3] < _UNDER * reach else None


def _most_of(points: np.ndarray, eyes: np.ndarray, tolerance: float) -> np.ndarray | None:
    """Find the plane [4] near most points, if possible with all cameras above; None if few points lie in one."""
    rng = np.random.default_rng(0)
    if len(points) > _SAMPLE:
        points = points[rng.permutation(len(points))[:_SAMPLE]]
    least = max(_LEAST_POINTS, int(_LEAST_SHARE * len(points)))
    if len(points) < least:
        return None
    best, plane = (False, 0), None
    for _ in range(_TRIALS):
        corners = points[rng.choice(len(points), 3, replace=False)]
        candidate = _plane(np.cross(corners[1] - corners[0], corners[2] - corners[0]), corners[0], eyes)
        if candidate is None:
            continue
        height = points @ candidate[:3] - candidate[3]
        near, above = int((np.abs(height) < tolerance).sum()), float((eyes @ candidate[:3] > candidate[3]).mean())
        is_free = float((height < -2 * tolerance).mean()) < _MOST_BELOW and above >= _ABOVE
        if is_free and near >= least and (above == 1, near) > best:
            best, plane = (above == 1, near), candidate
    if plane is None:
        return None
    flat = points[np.abs(points @ plane[:3] - plane[3]) < tolerance]
    return _plane(np.linalg.svd(flat - flat.mean(0))[2][2], flat.mean(0), eyes)


def _plane(normal: np.ndarray, point: np.ndarray, eyes: np.ndarray) -> np.ndarray | None:
    """Make the plane [4] through a point, its normal towards the cameras; None if the normal is 0."""
    length = float(np.linalg.norm(normal))
    if not length > 0:
        return None
    normal = normal / length * np.sign((eyes.mean(0) - point) @ normal)
    return np.append(normal, normal @ point)
