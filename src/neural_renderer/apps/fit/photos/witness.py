"""Evidence for and against a mesh in photographs, without the masks that were found in them.

Their depth was found without masks, by windows that look alike in three views or more. It shows which parts of a mesh
are where views see something, which parts views see through, and what stands there that the mesh lacks. Points of
structure from motion, found by features of whole photographs, show the latter, too; so do pixels around the mesh that
hide the background. Edges of the photographs should be where its outlines are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

from ....camera import Camera
from .beside import stands_beside
from .geometry.comparison import NEAR, compare_depth, scaled
from .geometry.depth import DepthMaps
from .geometry.solid import cloud_of, label_pieces, with_hanging

_THROUGH = 2.0  # distance behind a mesh, in units of `NEAR`: farther, a view sees through it
_REACH = 1.2  # radius around a mesh in which points are searched, relative to its longest side
_MOST_SAMPLES = 60_000
_OWN = 0.2  # a piece belongs to a mesh if at least this share of its points is near it
_LEAST_POINTS = 30  # fewer points of structure from motion are no evidence
_FLAT = 0.9  # cosine between the normal of what lies on a plane and the plane's
_EDGE, _ASIDE = 3, (5, 12)  # pixels of the window of an edge, and of the windows next to it
_FAINT = 1e-3  # smallest change of colour


@dataclass(frozen=True)
class Witness:
    """Shares in [0, 1] that photographs say of a mesh, unless it says something else."""

    lacking: float  # of the points that stand where the mesh does: the largest piece of those far from it
    confirmed: float  # of the pixels that show the mesh: those in which at least three views found it there
    seen_through: float  # of the pixels that show the mesh and have depth: those with something far behind it
    points: float  # of the points of structure from motion on what stands there: those near the mesh
    beside: float  # area around the outlines that hides the background, relative to the area inside
    lying: float  # of the pixels that show the mesh, in views from above: those flat on the plane under it
    edges: float  # change of colour at the outlines, relative to that next to them, ≥ 0


@torch.no_grad()
def ask(
    vertices: Tensor,
    faces: Tensor,
    camera: Camera,
    maps: DepthMaps,
    ground: np.ndarray | None,
    photos: Tensor,
    points: Tensor,
) -> Witness:
    """Compare a mesh with the photographs of N views, and their depth.

    Args:
        vertices, faces: The mesh in the world of the cameras.
        camera: The N cameras.
        maps: Depth of their views, [N, H, W]. If it marks others, something else may stand beside the mesh.
        ground: [4], plane (n, d) under the mesh, n upwards; or None.
        photos: Whole photographs [N, 3, H', W'].
        points: [P, 3], points of structure from motion.
    """
    scene = scaled(camera, maps, vertices, faces)
    center, side, shape = scene.center, scene.side, scene.shape
    plane = None if ground is None else np.append(ground[:3], (ground[3] - center.double().numpy() @ ground[:3]) / side)
    confirmed, through, known, covered, above, lying = 0, 0, 0, 0, 0, 0
    inside, eyes = [], scene.views.eyes()[0].double().numpy()
    for row, view in enumerate(compare_depth(scene)):
        inside.append(view.drawn.mask[0].numpy())
        covered, known = covered + int(view.core.sum()), known + int(view.has.sum())
        confirmed += int((view.has & (view.behind.abs() < view.error)).sum())
        through += int((view.has & (view.behind > _THROUGH * view.error)).sum())
        # From below, the bottom of an object in hands is flat, too.
        if plane is not None and eyes[row] @ plane[:3] > plane[3]:
            above += int(view.core.sum())
            lying += _lying(view.drawn.interpolate(shape[0])[0], view.core, plane)
    small = F.interpolate(photos.cpu().float(), maps.depth.shape[1:], mode="area")
    lacking, on_it = _lacking(shape, cloud_of(scene.views, scene.maps), (points.to(center) - center) / side, plane)
    return Witness(
        lacking,
        confirmed / max(covered, 1),
        through / max(known, 1),
        on_it,
        0.0 if maps.others is not None else stands_beside(small, camera, points, np.stack(inside), ground),
        lying / max(above, 1),
        edges(small, np.stack(inside)),
    )


def _lying(places: Tensor, inside: Tensor, ground: np.ndarray) -> int:
    """Count the pixels that show a surface flat on a plane, by the place [H, W, 3] of each pixel."""
    height = (places * torch.from_numpy(ground[:3]).to(places)).sum(2) - ground[3]
    step = torch.linalg.cross(places[:-1, 1:] - places[:-1, :-1], places[1:, :-1] - places[:-1, :-1])
    upright = (F.normalize(step, dim=2) * torch.from_numpy(ground[:3]).to(places)).sum(2).abs()
    return int((inside & (height < NEAR))[:-1, :-1][upright > _FLAT].sum())


def edges(photos: Tensor, inside: np.ndarray) -> float:
    """Compare the change of colours at outlines [N, H, W] with that on both sides: the median of their ratios."""
    found = []
    for photo, mask in zip(photos.numpy(), inside, strict=True):
        if not mask.any():
            continue
        slope = [ndimage.gaussian_gradient_magnitude(channel, 1.0) for channel in photo]
        change = ndimage.maximum_filter(np.sum(slope, 0), _EDGE)
        away = np.abs(ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask))
        at, aside = away <= 1, (away > _ASIDE[0]) & (away < _ASIDE[1])
        if at.any() and aside.any():
            found.append(float(np.median(change[at]) / (np.median(change[aside]) + _FAINT)))
    return float(np.median(found)) if found else 0.0


def _lacking(
    shape: tuple[Tensor, Tensor], cloud: Tensor, points: Tensor, ground: np.ndarray | None
) -> tuple[float, float]:
    """Compute the share of points [P, 3] on the object that are in the largest piece far from its mesh; 0 without any.

    Of points of structure from motion [S, 3] on that, the share near the mesh; 1 if they are few. The longest side of
    the mesh is 1, and its box is around the origin.
    """
    cloud = cloud[cloud.norm(dim=1) < _REACH]
    dense = cloud[:: max(1, len(cloud) // _MOST_SAMPLES)].double().numpy()
    if ground is not None:
        dense = dense[dense @ ground[:3] - ground[3] > NEAR]
    labels = label_pieces(dense, np.zeros(3), _REACH, NEAR)
    if not labels.any():
        return 0.0, 1.0
    corners = shape[0][shape[1]]
    samples = torch.cat((shape[0], corners.mean(1), corners.roll(1, 1).add(corners).div(2).flatten(0, 1)))
    mesh = cKDTree(samples.double().numpy())
    away = mesh.query(dense)[0]
    near, number = np.bincount(labels, away < NEAR), np.bincount(labels)
    near[0], number[0] = 0, 1
    pieces = sorted({int(near.argmax()), *np.flatnonzero(near > _OWN * number).tolist()})
    chosen = np.isin(labels, with_hanging(dense, labels, pieces, ground, _REACH))
    sparse = points.double().numpy()
    if ground is not None:
        sparse = sparse[sparse @ ground[:3] - ground[3] > NEAR]
    on_it = sparse[cKDTree(dense[chosen]).query(sparse)[0] < 2 * NEAR]
    share = float((mesh.query(on_it)[0] < NEAR).mean()) if len(on_it) >= _LEAST_POINTS else 1.0
    far = label_pieces(dense[chosen & (away > 2 * NEAR)], np.zeros(3), _REACH, NEAR)
    return float(np.bincount(far, minlength=2)[1:].max() / chosen.sum()), share
