"""Scenes of the benchmarks: noisy icospheres in screen space."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import neural_renderer as nr


def noisy_icospheres(batch: int, level: int, noise: float = 0.1, seed: int = 0, device: str = "cpu") -> Tensor:
    """Make spheres with randomly displaced vertices: corners [B, 20 * 4^level, 3, 3] in screen space.

    A sphere covers about half of the image. Half of the faces look away, as on any closed surface.
    """
    generator = torch.Generator().manual_seed(seed)
    vertices, faces = nr.icosphere(level)
    push = 1 + noise * torch.rand(batch, len(vertices), 1, generator=generator)
    camera = nr.Camera.look_at((0.0, 0.0, -2.732), viewing_angle=math.degrees(math.atan(0.36)))
    return nr.vertices_to_faces(camera(0.7 * vertices * push), faces).to(device)
