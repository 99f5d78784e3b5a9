"""Predicted shapes, of whatever kind: their voxels, their silhouettes, and how they look."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from ....render import render
from ..data.drawing import MESH_COLOR, VOXEL_COLOR, draw_mesh
from ..data.framing import SIZE, view_camera
from ..data.voxels import voxel_surface, voxelize
from .refine import refined


class Shapes(Protocol):
    """Predictions for B images."""

    def voxels(self) -> Tensor:
        """[B, 32, 32, 32] bool, in the axes of the published data."""

    def silhouettes(self, views: Tensor) -> Tensor:
        """Each prediction from ``views`` [B, K]: [B, K, 64, 64] in [0, 1]."""

    def picture(self, index: int, view: float, size: int) -> Tensor:
        """One prediction from a view: [3, size, size] in [0, 1]."""


Predictor = Callable[[Tensor], Shapes]
"""From images uint8 [B, 4, 64, 64] to their predictions."""


@dataclass(frozen=True)
class Meshes:
    """Vertices [B, V, 3] in the frame of reconstruction, and the faces [F, 3] of all."""

    vertices: Tensor
    faces: Tensor

    def voxels(self) -> Tensor:
        """See `voxels.voxelize`."""
        return voxelize(self.vertices, self.faces)

    def silhouettes(self, views: Tensor) -> Tensor:
        """See `Shapes`."""
        count = views.shape[1]
        vertices = self.vertices.repeat_interleave(count, 0)
        images = render(
            (vertices, self.faces), view_camera(views.flatten()), SIZE, outputs="alpha", anti_aliasing=False
        )
        return images.alpha.reshape(-1, count, SIZE, SIZE)  # type: ignore[union-attr]

    def picture(self, index: int, view: float, size: int) -> Tensor:
        """See `Shapes`."""
        return draw_mesh(self.vertices[index], self.faces, view, MESH_COLOR, size)


@dataclass(frozen=True)
class Solids:
    """Voxels [B, 32, 32, 32] bool."""

    filled: Tensor

    def voxels(self) -> Tensor:
        """Themselves."""
        return self.filled

    def silhouettes(self, views: Tensor) -> Tensor:
        """Those of the voxels as cubes."""
        result = torch.zeros(*views.shape, SIZE, SIZE, device=views.device)
        for row, solid in enumerate(self.filled):
            if bool(solid.any()):
                images = render(
                    voxel_surface(solid), view_camera(views[row]), SIZE, outputs="alpha", anti_aliasing=False
                )
                result[row] = images.alpha  # type: ignore[assignment]
        return result

    def picture(self, index: int, view: float, size: int) -> Tensor:
        """The voxels as cubes."""
        if not bool(self.filled[index].any()):
            return torch.full((3, size, size), 0.5)
        return draw_mesh(*voxel_surface(self.filled[index]), view, VOXEL_COLOR, size)


def network_predictor(model: Any, threshold: float = 0.5, refine: int = 0) -> Predictor:
    """What a trained network makes of images; voxels are those of a probability above ``threshold``.

    ``refine``: steps by which meshes are fitted to the silhouettes that went in (see `refine`).
    """

    @torch.no_grad()
    def predict(images: Tensor) -> Shapes:
        pixels = images.float() / 255
        if model.kind == "voxel":
            return Solids(model.occupancy(pixels) > threshold)
        vertices = model.vertices(pixels)
        return Meshes(refined(model, vertices, pixels, refine), model.faces)

    return predict
