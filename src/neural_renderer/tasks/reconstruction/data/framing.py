"""The frame of single-image reconstruction: where objects and cameras stand, as in the published renders.

An object's longest side is 1, its box centred at the origin. View k of K shows it from azimuth −360°·k/K, at elevation
30°, from the distance 2.732, with half a field of view of 15°. The published programs saw through a mirroring camera,
so that their objects are mirror images of the models that were rendered: (x, y, z) = (−z, y, −x) of the OBJ file, y up.
Networks are trained in that frame, so that published data and checkpoints fit; `mirrored` leads into it and out again.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ....camera import Camera, get_points_from_angles

DISTANCE = 2.732
ELEVATION = 30.0
VIEWING_ANGLE = 15.0
VIEWS = 24
SIZE = 64
GRID = 32


def mirrored(vertices: Tensor) -> Tensor:
    """Vertices [..., 3] of a model in the frame of reconstruction, or those of that frame as the model has them.

    A reflection, and its own inverse; faces that ran counter-clockwise seen from outside run clockwise afterwards.
    """
    x, y, z = vertices.unbind(-1)
    return torch.stack((-z, y, -x), -1)


def unit(vertices: Tensor) -> Tensor:
    """Vertices [V, 3] with their box centred at the origin and its longest side 1.

    Raises ValueError where all vertices coincide.
    """
    exact = vertices.double()
    low, high = exact.amin(0), exact.amax(0)
    longest = float((high - low).max())
    if longest == 0:
        raise ValueError(f"vertices: expected a shape with an extent, got {len(vertices)} vertices that all coincide")
    return ((exact - (low + high) / 2) / longest).to(vertices)


def view_camera(views: Tensor, count: int = VIEWS) -> Camera:
    """The cameras of views [B] (integers from 0 to ``count`` − 1), in the frame of reconstruction."""
    azimuth = -360.0 / count * views.to(torch.get_default_dtype())
    distance, elevation = torch.full_like(azimuth, DISTANCE), torch.full_like(azimuth, ELEVATION)
    eye = get_points_from_angles(distance, elevation, azimuth)
    return Camera.look_at(eye, viewing_angle=VIEWING_ANGLE, mirrored=True)
