"""From pictures to meshes, as the models that were learned from stand: not mirrored, y up, the longest side about 1."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....meshes.isosurface import isosurface
from ....metrics import silhouette_iou
from ..data.drawing import draw_mesh, on_paper
from ..data.framing import VIEWS, mirror
from .cutout import framed
from .predictors import Predictor
from .refine import refined

_EXTENTS = tuple(range(28, 61, 4))
_CELLS = 64
_AROUND = 16


@torch.no_grad()
def best_frame(predict: Predictor, rgba: Tensor, device: torch.device | str = "cpu") -> Tensor:
    """A cut-out [4, H, W] (see `cutout.cut_out`) framed as the network knows such objects: uint8 [4, 64, 64].

    How large an object is in the training data depends on its shape, which is not known yet. Of several sizes that one
    is chosen whose prediction, from some view, casts the silhouette that went in: with another size the network is
    asked for what it has never seen. Raises ValueError for an object of a few pixels.
    """
    images = torch.stack([framed(rgba, extent) for extent in _EXTENTS]).to(device)
    views = torch.arange(VIEWS, device=images.device).expand(len(images), -1)
    outlines = predict(images).silhouettes(views) > 0.5
    masks = (images[:, 3:] > 127).expand_as(outlines)
    agreement = silhouette_iou(outlines.flatten(0, 1), masks.flatten(0, 1)).reshape(len(images), VIEWS)
    return images[agreement.amax(1).argmax()].cpu()


@torch.no_grad()
def predict_meshes(model: Any, images: Tensor, threshold: float = 0.5, refine: int = 0) -> list[tuple[Tensor, Tensor]]:
    """What a trained network makes of images uint8 [B, 4, 64, 64] (see `cutout.framed`): vertices [V, 3], faces [F, 3].

    The mesh of a voxel network is the surface where its probabilities, blended between voxels, are ``threshold``; that
    of a mesh network is fitted by ``refine`` steps to the silhouette that went in (see `refine`).
    Vertices are in the frame of the models (`framing.mirror` is undone), on the CPU; faces run counter-clockwise
    seen from outside. Raises ValueError if a network finds nothing solid in an image.
    """
    pixels = images.float() / 255
    if model.kind == "mesh":
        faces = model.faces.flip(1).cpu()
        meshes = refined(model, model.vertices(pixels), pixels, refine)
        return [(mirror(vertices), faces) for vertices in meshes.cpu()]
    return [_voxel_mesh(occupancy, threshold) for occupancy in model.occupancy(pixels).cpu()]


def _voxel_mesh(occupancy: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
    if float(occupancy.max()) <= threshold:
        raise ValueError(f"expected a solid shape, got a prediction of no voxel above the threshold {threshold}")
    last = len(occupancy) - 1
    field = F.pad(occupancy[None, None], (1,) * 6)  # nothing beyond the grid
    scale = last / (last + 2)

    def distance(points: np.ndarray) -> np.ndarray:
        x, y, z = torch.from_numpy(points).float().mul(2 * scale).unbind(-1)
        place = torch.stack((-z, x, y), -1)  # of the axes (y, x, −z), the last one first
        value = F.grid_sample(field, place[None], padding_mode="zeros", align_corners=True)[0, 0]
        return threshold - value.numpy().astype(np.float64)

    vertices, faces = isosurface(distance, _CELLS, 0.5 * (1 + 1.9 / last))
    return mirror(vertices), faces.flip(1)


def prediction_picture(picture: Tensor, image: Tensor, vertices: Tensor, faces: Tensor, size: int = 128) -> Tensor:
    """What was given ([H, W, 3 or 4]), what the network saw (uint8 [4, 64, 64]), and 16 views of the mesh.

    Three rows of six, [3, 3 · size, 6 · size] in [0, 1]; vertices as `predict_meshes` gives them.
    """
    height, width = picture.shape[:2]
    alpha = picture[..., 3:] if picture.shape[2] == 4 else torch.ones(height, width, 1)
    pixels = torch.cat((picture[..., :3] * alpha, alpha), 2).permute(2, 0, 1)
    fit = [max(1, round(size * side / max(height, width))) for side in (height, width)]
    fitted = F.interpolate(pixels[None], fit, mode="bilinear", antialias=True, align_corners=False)[0]
    given = torch.zeros(4, size, size)
    top, left = (size - fit[0]) // 2, (size - fit[1]) // 2
    given[:, top : top + fit[0], left : left + fit[1]] = fitted
    seen = F.interpolate(on_paper(image)[None], (size, size), mode="nearest")[0]
    paper = on_paper(torch.zeros(4, 1, 1, dtype=torch.uint8))
    cells = [(given[:3] + paper * (1 - given[3:])).clamp(0, 1), seen]
    cells += [draw_mesh(mirror(vertices), faces, VIEWS * turn / _AROUND, size=size) for turn in range(_AROUND)]
    return torch.cat([torch.cat(cells[row : row + 6], 2) for row in (0, 6, 12)], 1)
