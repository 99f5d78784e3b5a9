"""The reconstruction frame: poses of objects and cameras in the published data set.

The bounding box of an object is centred at the origin, and its longest side is 1. View k of K has azimuth −360°·k/K,
elevation 30°, distance 2.732 and a half field of view of 15°. The published code used a mirroring camera; therefore
objects in this frame are mirror images of the models: (x, y, z) here is (−z, y, −x) of the OBJ file, with y up.
Networks are trained in this frame, so that published data and checkpoints fit. `mirror` converts to it and back.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ....camera import Camera, get_points_from_angles
from ....meshes.bounds import centered
from ..settings import SIZE as SIZE
from ..settings import VIEWS as VIEWS

DISTANCE = 2.732
ELEVATION = 30.0
VIEWING_ANGLE = 15.0
GRID = 32  # voxels along each axis
SPLITS = ("train", "val", "test")


def mirror(vertices: Tensor) -> Tensor:
    """Convert vertices [..., 3] from the frame of the models to the reconstruction frame, or back.

    The map is a reflection and its own inverse. It reverses the winding of faces.
    """
    x, y, z = vertices.unbind(-1)
    return torch.stack((-z, y, -x), -1)


def scale_to_unit(vertices: Tensor) -> Tensor:
    """Move and scale vertices [V, 3]: the bounding box is centred at the origin, and its longest side is 1."""
    return (centered(vertices) / 2).to(vertices)


def view_camera(views: Tensor, count: int = VIEWS) -> Camera:
    """Make the cameras of views [B] of ``count`` around an object; fractions lie between two views."""
    azimuth = -360.0 / count * views.to(torch.get_default_dtype())
    distance, elevation = torch.full_like(azimuth, DISTANCE), torch.full_like(azimuth, ELEVATION)
    eye = get_points_from_angles(distance, elevation, azimuth)
    return Camera.look_at(eye, viewing_angle=VIEWING_ANGLE, mirrored=True)
