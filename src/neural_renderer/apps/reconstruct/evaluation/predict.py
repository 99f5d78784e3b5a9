"""Meshes from pictures, in the frame of the models: not mirrored, y up, the longest side about 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....meshes.mesh import Mesh
from ....meshes.normals import vertex_normals
from ....optim.metrics import silhouette_iou
from ...common.geometry.isosurface import isosurface
from ...common.observer import Observer, goes_on
from ..data.drawing import draw_mesh, on_paper
from ..data.framing import VIEWS, mirror
from ..options import EvaluateOptions
from .cutout import frame_object
from .predictors import Predictor
from .refine import refine_meshes

_EXTENTS = tuple(range(28, 61, 4))  # lengths of the object's longer side to try, in pixels
_INWARD = 0.4  # distance by which a predicted surface moves inwards, in voxels; a half would close thin parts
_CELLS = 64  # grid cells along each axis for the isosurface of voxels
_AROUND, _COLUMNS = 16, 6  # views of the mesh in a picture of a prediction, and pictures in a row


@torch.no_grad()
def best_frame(predict: Predictor, rgba: Tensor, device: torch.device | str = "cpu") -> Tensor:
    """Frame a cut-out object [4, H, W], as from `cutout.cut_out`, at the best prediction's size: [4, 64, 64] uint8.

    The size of an object in the training data depends on its unknown shape. This function tries several sizes and
    compares the silhouettes of the predictions, from all views, with the object's. ValueError: It has less than 8
    pixels.
    """
    images = torch.stack([frame_object(rgba, extent) for extent in _EXTENTS]).to(device)
    views = torch.arange(VIEWS, device=images.device).expand(len(images), -1)
    silhouettes = predict(images).silhouettes(views) > 0.5
    masks = (images[:, 3:] > 127).expand_as(silhouettes)
    iou = silhouette_iou(silhouettes.flatten(0, 1), masks.flatten(0, 1)).reshape(len(images), VIEWS)
    return images[iou.amax(1).argmax()].cpu()


@torch.no_grad()
def predict_meshes(
    model: Any,
    images: Tensor,
    threshold: float = EvaluateOptions.threshold,
    refine: int = 0,
    observer: Observer | None = None,
    name: str | None = None,
) -> list[tuple[Tensor, Tensor]]:
    """Predict meshes from images [B, 4, 64, 64] uint8, as `cutout.frame_object` gives; ValueError if one is empty.

    Returns vertices [V, 3] and outward faces [F, 3] of each, in the frame of the models, on the CPU. A voxel network
    gives the isosurface of its interpolated probabilities at the threshold; a mesh network is refined by some steps
    (`refine.refine_meshes`), of which the observer sees those of the first mesh, by its name.
    """
    pixels = images.float() / 255
    if model.kind == "mesh":
        faces = model.faces.flip(1).cpu()

        def observe(step: int, loss: float, vertices: Callable[[], Tensor]) -> bool:
            def shown() -> Any:
                mesh = mirror(vertices()[0].cpu()), faces
                return mesh if name is None else {name: mesh}

            if observer is not None:
                phase = "refinement" if name is None else f"{name}: refinement"
                observer.observe(phase, step, refine, {"loss": loss}, shown)
            return goes_on(observer)

        meshes = refine_meshes(model, model.vertices(pixels), pixels, refine, None if observer is None else observe)
        return [(mirror(vertices), faces) for vertices in meshes.cpu()]
    return [voxel_mesh(occupancy, threshold) for occupancy in model.occupancy(pixels).cpu()]


def voxel_mesh(occupancy: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
    """Convert probabilities [32, 32, 32] to a mesh in the frame of the models.

    Voxels are filled that the surface touches, so the surface lies about half a voxel inside of theirs.
    """
    if float(occupancy.max()) <= threshold:
        raise ValueError(f"expected a solid shape, got a prediction without a voxel above the threshold {threshold}")
    last = len(occupancy) - 1
    field = F.pad(occupancy[None, None], (1,) * 6)  # empty outside of the grid
    scale = last / (last + 2)

    def distance(points: np.ndarray) -> np.ndarray:
        x, y, z = torch.from_numpy(points).float().mul(2 * scale).unbind(-1)
        place = torch.stack((-z, x, y), -1)  # `grid_sample` takes the last of the axes (y, x, −z) first
        value = F.grid_sample(field, place[None], padding_mode="zeros", align_corners=True)[0, 0]
        return threshold - value.numpy().astype(np.float64)

    vertices, faces = isosurface(distance, _CELLS, 0.5 * (1 + 1.9 / last))
    vertices = vertices - _INWARD / last * vertex_normals(vertices, faces)[0]
    return mirror(vertices), faces.flip(1)


def prediction_picture(picture: Tensor, image: Tensor, mesh: Mesh, size: int = 128) -> Tensor:
    """Draw the given picture, the input of the network, and 16 views of the mesh, in three rows of six.

    The given picture is [H, W, 3 or 4] in [0, 1], the input [4, 64, 64] uint8. The result is [3, 3 · size, 6 · size].
    """
    height, width = picture.shape[:2]
    alpha = picture[..., 3:] if picture.shape[2] == 4 else torch.ones(height, width, 1)
    pixels = torch.cat((picture[..., :3] * alpha, alpha), 2).permute(2, 0, 1)
    shape = [max(1, round(size * side / max(height, width))) for side in (height, width)]
    resized = F.interpolate(pixels[None], shape, mode="bilinear", antialias=True, align_corners=False)[0]
    given = torch.zeros(4, size, size)
    top, left = (size - shape[0]) // 2, (size - shape[1]) // 2
    given[:, top : top + shape[0], left : left + shape[1]] = resized
    network_input = F.interpolate(on_paper(image)[None], (size, size), mode="nearest")[0]
    paper = on_paper(torch.zeros(4, 1, 1, dtype=torch.uint8))
    cells = [(given[:3] + paper * (1 - given[3:])).clamp(0, 1), network_input]
    faces = mesh.faces.long()
    colors = mesh.textures if mesh.vertex_colors is None else mesh.vertex_colors[faces]
    for turn in range(_AROUND):
        cells.append(draw_mesh(mirror(mesh.vertices), faces, VIEWS * turn / _AROUND, colors, size))
    return torch.cat([torch.cat(cells[row : row + _COLUMNS], 2) for row in range(0, len(cells), _COLUMNS)], 1)
