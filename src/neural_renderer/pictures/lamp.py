"""The lamp of pictures: a directional light that follows the camera."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from ..camera import Camera

LAMP = (-0.45, 0.8, 0.5)
"""Direction of the default lamp along the camera's right, up and backward axes: over the viewer's left shoulder."""


def lamp_direction(camera: Camera, lamp: tuple[float, float, float] = LAMP) -> Tensor:
    """Convert a direction in camera axes to world space.

    Args:
        camera: One camera.
        lamp: Direction towards the light along the camera's right, up and backward axes, of any length.

    Returns:
        [3] float32, unit vector in world space, as `Light.direction` takes it.
    """
    right, up, forward = camera.axes[0]
    return F.normalize(lamp[0] * right + lamp[1] * up - lamp[2] * forward, dim=0)
