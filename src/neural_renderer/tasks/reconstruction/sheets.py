"""Pictures to look at: the data, what a network made of them, and whether voxels and images show the same."""

from __future__ import annotations

import torch
from torch import Tensor

from ...lighting import Light
from ...metrics import silhouette_iou
from ...render import render
from .arrays import Split
from .framing import SIZE, VIEWS, view_camera
from .voxels import surface

CLAY = (0.86, 0.84, 0.8)
STONE = (0.72, 0.77, 0.84)
_PAPER = 0.8
_LAMP = (-0.45, 0.8, 0.5)  # towards the light, in the viewer's right, up and back


@torch.no_grad()
def drawn(
    vertices: Tensor, faces: Tensor, view: float, colour: tuple[float, float, float] = CLAY, size: int = SIZE
) -> Tensor:
    """A mesh in the frame of reconstruction from a view, or from between two: [3, size, size] in [0, 1]."""
    camera = view_camera(torch.tensor([view], device=vertices.device))
    right, up, forward = camera.rotation[0]
    lamp = torch.nn.functional.normalize(_LAMP[0] * right + _LAMP[1] * up - _LAMP[2] * forward, dim=0)
    light = Light(0.42, 0.6, direction=lamp)
    textures = torch.tensor(colour, device=vertices.device).expand(len(faces), 2, 2, 2, 3)
    rgb = render((vertices, faces, textures), camera, size, light=light, background=(_PAPER,) * 3, outputs="rgb").rgb
    return rgb[0].clamp(0, 1)  # type: ignore[index]


def shown(image: Tensor) -> Tensor:
    """An image of the data, uint8 [4, H, W], on paper: [3, H, W] in [0, 1]."""
    pixels = image.float() / 255
    return pixels[:3] * pixels[3:] + _PAPER * (1 - pixels[3:])


def data_sheet(split: Split, name: str, most: int = 48, columns: int = 8) -> Tensor:
    """The objects of a class, one a row: some of their views, and their voxels from the first and the last of those."""
    rows = []
    for index in _spread(len(split.images[name]), most):
        views = [round(column * VIEWS / columns) for column in range(columns)]
        row = [shown(torch.from_numpy(split.images[name][index, view].copy())) for view in views]
        if name in split.voxels:
            solid = surface(torch.from_numpy(split.voxels[name][index].copy()))
            row += [drawn(*solid, view, STONE) for view in (views[1], views[-2])]
        rows.append(torch.cat(row, 2))
    return torch.cat(rows, 1)


def agreement(split: Split, name: str, most: int = 8) -> float:
    """The mean IoU of the voxels' outlines and the images', of some objects of a class, each from four views.

    Voxels are coarse, so that thin objects reach 0.5; of other axes, or another order of the views, much less is left.
    """
    values = []
    views = torch.arange(0, VIEWS, VIEWS // 4)
    for index in _spread(len(split.images[name]), most):
        vertices, faces = surface(torch.from_numpy(split.voxels[name][index].copy()))
        images = render((vertices, faces), view_camera(views), SIZE, outputs="alpha")
        masks = torch.from_numpy(split.images[name][index, views.numpy(), 3].copy()) > 127
        values.append(silhouette_iou(images.alpha, masks))  # type: ignore[arg-type]
    return float(torch.cat(values).mean())


def _spread(count: int, most: int) -> list[int]:
    """Up to ``most`` of ``count`` numbers, evenly spread."""
    return sorted({round(index * (count - 1) / max(min(most, count) - 1, 1)) for index in range(min(most, count))})
