"""Objects in the frame of reconstruction, and images of the data, as pictures for people."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ....camera import Camera
from ....rendering import render
from ....shading.lights import Light
from .framing import SIZE, view_camera

CLAY = (0.86, 0.84, 0.8)
STONE = (0.72, 0.77, 0.84)
PAPER = 0.8
_LAMP = (-0.45, 0.8, 0.5)  # towards the light, in the viewer's right, up and back: a box shows three shades


def shoulder_light(camera: Camera, directional: float = 0.6) -> Light:
    """The light of a camera's picture, over the viewer's left shoulder, so that no view is dark."""
    right, up, forward = camera.rotation[0]
    return Light(0.42, directional, direction=F.normalize(_LAMP[0] * right + _LAMP[1] * up - _LAMP[2] * forward, dim=0))


@torch.no_grad()
def drawn(
    vertices: Tensor, faces: Tensor, view: float, colour: tuple[float, float, float] = CLAY, size: int = SIZE
) -> Tensor:
    """A mesh in the frame of reconstruction from a view, or from between two: [3, size, size] in [0, 1]."""
    camera = view_camera(torch.tensor([view], device=vertices.device))
    textures = torch.tensor(colour, device=vertices.device).expand(len(faces), 2, 2, 2, 3)
    light = shoulder_light(camera)
    rgb = render((vertices, faces, textures), camera, size, light=light, background=(PAPER,) * 3, outputs="rgb").rgb
    return rgb[0].clamp(0, 1)  # type: ignore[index]


def shown(image: Tensor) -> Tensor:
    """An image of the data, uint8 [4, H, W], on paper: [3, H, W] in [0, 1]."""
    pixels = image.float() / 255
    return pixels[:3] * pixels[3:] + PAPER * (1 - pixels[3:])
