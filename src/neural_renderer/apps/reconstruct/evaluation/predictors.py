"""One interface to predicted meshes and voxels: their voxels, silhouettes and pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from ....rendering.forward import render
from ..data.drawing import MESH_COLOR, VOXEL_COLOR, draw_mesh
from ..data.framing import SIZE, view_camera
from ..data.voxels import voxel_surface, voxelize
from ..networks.shape_network import Known, ShapeNetwork
from ..options import EvaluateOptions
from .refine import refine_meshes


class Predictions(Protocol):
    """Predicted shapes of B images."""

    def voxels(self) -> Tensor:
        """Voxelise the predictions: [B, 32, 32, 32] bool, in the published axes."""

    def silhouettes(self, views: Tensor) -> Tensor:
        """Render silhouettes from views [B, K]: [B, K, 64, 64] in [0, 1]."""

    def picture(self, index: int, view: float, size: int) -> Tensor:
        """Draw one prediction from a view: [3, size, size] in [0, 1]."""


Predictor = Callable[[Tensor], Predictions]
"""A method: maps images [B, 4, 64, 64] uint8 to `Predictions`."""


@dataclass(frozen=True)
class MeshPredictions:
    """Predicted meshes."""

    vertices: Tensor  # [B, V, 3] in the reconstruction frame
    faces: Tensor  # [F, 3], the same for all

    def voxels(self) -> Tensor:
        """Voxelise the meshes by `voxels.voxelize`."""
        return voxelize(self.vertices, self.faces)

    def silhouettes(self, views: Tensor) -> Tensor:
        """Render silhouettes, [B, K, 64, 64]; see `Predictions`."""
        count = views.shape[1]
        vertices = self.vertices.repeat_interleave(count, 0)
        images = render(
            (vertices, self.faces), view_camera(views.flatten()), SIZE, outputs="alpha", anti_aliasing=False
        )
        return images.alpha.reshape(-1, count, SIZE, SIZE)

    def picture(self, index: int, view: float, size: int) -> Tensor:
        """Draw one mesh, [3, size, size]; see `Predictions`."""
        return draw_mesh(self.vertices[index], self.faces, view, MESH_COLOR, size)


@dataclass(frozen=True)
class VoxelPredictions:
    """Predicted voxels, drawn as cubes.

    Attributes:
        filled: [B, 32, 32, 32] bool, in the published axes.
    """

    filled: Tensor

    def voxels(self) -> Tensor:
        """Return ``filled``."""
        return self.filled

    def silhouettes(self, views: Tensor) -> Tensor:
        """Render silhouettes, [B, K, 64, 64]; see `Predictions`."""
        result = torch.zeros(*views.shape, SIZE, SIZE, device=views.device)
        for row, voxels in enumerate(self.filled):
            if bool(voxels.any()):
                surface, camera = voxel_surface(voxels), view_camera(views[row])
                result[row] = render(surface, camera, SIZE, outputs="alpha", anti_aliasing=False).alpha
        return result

    def picture(self, index: int, view: float, size: int) -> Tensor:
        """Draw one prediction, [3, size, size]; see `Predictions`."""
        if not bool(self.filled[index].any()):
            return torch.full((3, size, size), 0.5)
        return draw_mesh(*voxel_surface(self.filled[index]), view, VOXEL_COLOR, size)


def network_predictor(model: Any, threshold: float = EvaluateOptions.threshold, refine: int = 0) -> Predictor:
    """Wrap a trained network as a `Predictor`.

    Voxels are filled above the probability ``threshold``; meshes are refined by ``refine`` steps of `refine_meshes`.
    """

    @torch.no_grad()
    def predict(images: Tensor) -> Predictions:
        pixels = images.float() / 255
        if model.kind == "shape":
            return VoxelPredictions(model.published_occupancy(pixels) > threshold)
        if model.kind == "voxel":
            return VoxelPredictions(model.occupancy(pixels) > threshold)
        vertices = model.vertices(pixels)
        return MeshPredictions(refine_meshes(model, vertices, pixels, refine), model.faces)

    return predict


def shape_predictor(model: ShapeNetwork, known: Known, threshold: float = EvaluateOptions.threshold) -> Predictor:
    """Wrap a `ShapeNetwork` that knows part of the poses (``known``): images are views 0, 1, … of one object."""

    @torch.no_grad()
    def predict(images: Tensor) -> Predictions:
        probability = model.published_occupancy(images.float() / 255, torch.arange(len(images)), known)
        return VoxelPredictions(probability > threshold)

    return predict
