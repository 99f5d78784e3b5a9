"""Pictures to look at: the data, what a network made of them, and whether voxels and images show the same."""

from __future__ import annotations

import torch
from torch import Tensor

from ...metrics import silhouette_iou
from ...render import render
from .arrays import Split
from .drawing import STONE, drawn, shown
from .framing import SIZE, VIEWS, view_camera
from .shapes import Predictor, Solids
from .voxels import surface


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


@torch.no_grad()
def prediction_sheet(
    predictors: dict[str, Predictor], split: Split, each: int = 2, size: int = 96, turns: tuple[int, ...] = (0, 5, 12)
) -> Tensor:
    """A few objects of each class: an input; of each predictor, the shape from three views; the voxels to be found.

    The views are the input's own, and ``turns`` further around. Rows of objects, [3, rows · size, columns · size].
    """
    rows = []
    for number, name in enumerate(split.classes):
        for index in _spread(len(split.images[name]), each):
            view = (7 * number + 5 * index + 2) % VIEWS
            image = torch.from_numpy(split.images[name][index, view].copy())
            truth = Solids(torch.from_numpy(split.voxels[name][index].copy())[None])
            predictions = [predict(image[None]) for predict in predictors.values()]
            row = [torch.nn.functional.interpolate(shown(image)[None], (size, size), mode="bilinear")[0]]
            for shapes in (*predictions, truth):
                row += [shapes.picture(0, (view + turn) % VIEWS, size) for turn in turns]
            rows.append(torch.cat(row, 2))
    return torch.cat(rows, 1)
