"""Pictures of looks: what the cameras of the improvement see of the original, and of the small mesh."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...camera import Camera
from ...raster.fragments import Fragments
from ...rendering.deferred import fragments
from .source import CHANNELS, Source


@dataclass(frozen=True, eq=False)
class Target:
    """What a camera sees of the original.

    Attributes:
        camera: The camera.
        looks: [C, S, S] looks, 0 behind.
        shape: [4, S, S] points relative to the centre, and coverage; all 0 behind.
    """

    camera: Camera
    looks: Tensor
    shape: Tensor


@torch.no_grad()
def draw_target(source: Source, camera: Camera, size: int, center: Tensor, half: float) -> Target:
    """Draw the look and the shape of the original, anti-aliased, in a picture of ``size``² pixels."""
    visible = fragments((source.vertices, source.faces.int()), camera, size)
    covered = torch.nonzero(visible.face_index[0].flatten() >= 0)[:, 0]
    weights = visible.weights[0].reshape(-1, 3)[covered]
    face = visible.face_index[0].flatten()[covered].long()
    values = torch.zeros(visible.face_index[0].numel(), CHANNELS + 4)
    values[covered, :CHANNELS] = source.look(face, weights)
    points = torch.einsum("nk,nkc->nc", weights, source.vertices[source.faces[face]])
    values[covered, CHANNELS:-1] = ((points - center) / half).float()
    values[covered, -1] = 1
    drawn = visible.composite(values.view(*visible.face_index.shape, -1))[0]
    return Target(camera, drawn[:CHANNELS].contiguous(), drawn[CHANNELS:].contiguous())


def shape_of(visible: Fragments, vertices: Tensor, center: Tensor, half: float) -> Tensor:
    """Draw points relative to the centre, and coverage, [B, 4, S, S]; differentiable in the vertices."""
    relative = (vertices - center.float()) / half
    points = torch.cat((relative, torch.ones_like(relative[:, :1])), 1)
    return visible.composite(visible.interpolate(points))
