"""Contact sheets of data sets and predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from ..data.arrays import Split
from ..data.drawing import PAPER, VOXEL_COLOR, draw_mesh, on_paper
from ..data.framing import SIZE, VIEWS
from ..data.voxels import voxel_surface
from .predictors import Predictor, VoxelPredictions

_INK = 40  # grey level of titles, of 255


def data_sheet(split: Split, name: str, most: int = 48, columns: int = 8) -> Tensor:
    """Draw up to ``most`` objects of a class, one per row: views, then the voxels, if there are any, from two of them.

    Returns [3, rows · 64, columns · 64] in [0, 1].
    """
    rows = []
    for index in evenly_spaced(len(split.images[name]), most):
        views = [round(column * VIEWS / columns) for column in range(columns)]
        row = [on_paper(torch.from_numpy(split.images[name][index, view].copy())) for view in views]
        if name in split.voxels:
            surface = voxel_surface(torch.from_numpy(split.voxels[name][index].copy()))
            row += [draw_mesh(*surface, view, VOXEL_COLOR) for view in (views[1], views[-2])]
        rows.append(torch.cat(row, 2))
    return torch.cat(rows, 1)


def evenly_spaced(count: int, most: int) -> list[int]:
    """Choose up to ``most`` evenly spaced indices below ``count``."""
    return sorted({round(index * (count - 1) / max(min(most, count) - 1, 1)) for index in range(min(most, count))})


@torch.no_grad()
def prediction_sheet(
    predictors: dict[str, Predictor], split: Split, each: int = 2, size: int = 96, turns: tuple[int, ...] = (0, 5, 12)
) -> Tensor:
    """Draw some objects of each class, one per row: the input, the predictions of each method, and the true voxels.

    ``turns`` are the views to draw, relative to that of the input. The result is [3, 20 + rows · size, columns · size];
    the first 20 rows of pixels are titles.
    """
    rows = []
    for number, name in enumerate(split.classes):
        for index in evenly_spaced(len(split.images[name]), each):
            view = (7 * number + 5 * index + 2) % VIEWS
            image = torch.from_numpy(split.images[name][index, view].copy())
            truth = VoxelPredictions(torch.from_numpy(split.voxels[name][index].copy())[None])
            predictions = [predict(image[None]) for predict in predictors.values()]
            row = [torch.nn.functional.interpolate(on_paper(image)[None], (size, size), mode="bilinear")[0]]
            for shapes in (*predictions, truth):
                row += [shapes.picture(0, (view + turn) % VIEWS, size).cpu() for turn in turns]
            rows.append(torch.cat(row, 2))
    titles = ["input", *(title for name in (*predictors, "truth") for title in (name, *[""] * (len(turns) - 1)))]
    return torch.cat((_header(titles, size), *rows), 1)


@torch.no_grad()
def training_sheet(predict: Predictor, split: Split, most: int = 13, turns: tuple[int, ...] = (0, 6, 15)) -> Tensor:
    """Draw the first object of each class, one per row: the input, the prediction, and the object's own images.

    ``turns`` are the views to draw, relative to that of the input. The result is [3, rows · 64, (1 + 2 · len(turns)) ·
    64].
    """
    rows = []
    for number, name in enumerate(split.classes[:most]):
        images = torch.from_numpy(split.images[name][0].copy())
        input_view = (7 * number + 2) % VIEWS
        views = [(input_view + turn) % VIEWS for turn in turns]
        predictions = predict(images[input_view][None])
        row = [on_paper(images[input_view])] + [predictions.picture(0, view, SIZE).cpu() for view in views]
        rows.append(torch.cat(row + [on_paper(images[view]) for view in views], 2))
    return torch.cat(rows, 1)


def _header(titles: Sequence[str], size: int, height: int = 20) -> Tensor:
    """Draw the titles of columns, [3, height, columns · size]."""
    image = Image.new("L", (len(titles) * size, height), round(255 * PAPER))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(12)
    for column, title in enumerate(titles):
        draw.text((column * size + 4, 3), title, _INK, font)
    return (torch.from_numpy(np.array(image)).float() / 255).expand(3, -1, -1)
