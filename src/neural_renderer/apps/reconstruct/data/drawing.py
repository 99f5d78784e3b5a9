"""Pictures of objects in the reconstruction frame, and of images of the data set."""

from __future__ import annotations

import torch
from torch import Tensor

from ....rendering.forward import render
from ....shading.lights import CameraLight
from ...common.pictures.clay import plain_texture
from ...common.pictures.photograph import LAMP
from .framing import SIZE, view_camera

MESH_COLOR = (0.86, 0.84, 0.8)
VOXEL_COLOR = (0.72, 0.77, 0.84)
PAPER = 0.8  # grey of the background
SHOULDER = CameraLight(0.42, 0.6, LAMP)  # no view is dark


@torch.no_grad()
def draw_mesh(
    vertices: Tensor,
    faces: Tensor,
    view: float,
    color: tuple[float, float, float] | Tensor = MESH_COLOR,
    size: int = SIZE,
) -> Tensor:
    """Draw a mesh in the reconstruction frame, [3, size, size] in [0, 1]. A fractional view lies between two views.

    ``color`` is one RGB, or textures or colours of corners as of `render`.
    """
    camera = view_camera(torch.tensor([view], device=vertices.device))
    textures = color if isinstance(color, Tensor) else plain_texture(faces, color)
    mesh = vertices, faces, textures
    rgb = render(mesh, camera, size, light=SHOULDER, background=(PAPER,) * 3, outputs="rgb").rgb
    return rgb[0].clamp(0, 1)


def on_paper(image: Tensor) -> Tensor:
    """Draw an image of the data set, uint8 [4, H, W], on the background: [3, H, W] in [0, 1]."""
    pixels = image.float() / 255
    return pixels[:3] * pixels[3:] + PAPER * (1 - pixels[3:])
