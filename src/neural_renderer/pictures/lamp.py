"""The lamp of pictures: a directional light that follows the camera."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from ..camera import Camera

LAMP = (-0.45, 0.8, 0.5)
"""Direction of the default lamp along the camera's right, up and backward axes: over the viewer's left shoulder."""


def lamp_direction(camera: Camera, lamp: tuple[float, float, float] = LAMP) -> Tensor:
    """Convert a direction along one camera's right, up and backward axes to a unit vector [3] in world space."""
    right, up, forward = camera.axes[0]
    return F.normalize(lamp[0] * right + lamp[1] * up - lamp[2] * forward, dim=0)
