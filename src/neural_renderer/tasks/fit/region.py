"""The region of an object: from a box, or from points of the scene."""

from __future__ import annotations

import torch
from torch import Tensor

from ... import validate
from ...camera import Camera
from ...meshes.primitives import cube
from .fit_views import Views, mask_values

_SHARE = 0.9  # of the views in whose masks a point must lie to belong to the object
_LEAST_POINTS = 8
_TAIL = 0.02  # of the points on each side are left out as errors
_LARGER = 1.5  # than the box around the points; smooth parts of an object have none


def outline_of_box(
    camera: Camera, box: tuple[float, ...], size: tuple[int, int]
) -> tuple[Tensor, tuple[Tensor, float]]:
    """Draw a box.

    Args:
        camera: N cameras.
        box: Opposite corners (x, y, z, x, y, z) in the world.
        size: Height and width of the images in pixels.

    Returns:
        Its outlines [N, H, W] in [0, 1]; its centre [3], and half its longest side.

    Raises:
        ValueError: There are not six finite numbers, or a side is not above 0.
    """
    values = [validate.number("box", value) for value in box]
    if len(values) != 6:
        raise ValueError(f"box: expected six numbers x, y, z, x, y, z, got {len(values)}")
    corners = torch.tensor(values).view(2, 3)
    center, half = corners.mean(0), (corners[1] - corners[0]).abs() / 2
    if not bool((half > 0).all()):
        raise ValueError(f"box: expected opposite corners that differ in x, y and z, got {tuple(box)}")
    vertices, faces = cube()
    views = Views(camera, torch.ones(len(camera), *size)).normalized(center, float(half.max()))
    return views.draw((vertices * half / half.max(), faces)).alpha, (center, float(half.max()))


def region_of_points(views: Views, points: Tensor) -> tuple[Tensor, float] | None:
    """Find the region of the object from points of the scene, of which some belong to its surroundings.

    Args:
        views: The views.
        points: [P, 3] in the world.

    Returns:
        The centre [3] of the points inside the masks and half the side of a cube around them, with a margin; None if
        there are too few.
    """
    points = points.to(views.masks)
    count = torch.stack([value > 0.5 for value in mask_values(views, views.masks, points)]).sum(0)
    found = points[count >= _SHARE * len(views)]
    if len(found) < _LEAST_POINTS:
        return None
    least, most = (found.quantile(share, dim=0) for share in (_TAIL, 1 - _TAIL))
    return (least + most) / 2, _LARGER * float((most - least).max()) / 2
