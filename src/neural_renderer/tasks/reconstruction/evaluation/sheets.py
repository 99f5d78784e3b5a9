"""Pictures to look at: the data, and what a network made of them."""

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
from .predictors import Predictor, Solids


def data_sheet(split: Split, name: str, most: int = 48, columns: int = 8) -> Tensor:
    """The objects of a class, one a row: some of their views, and their voxels from the first and the last of those."""
    rows = []
    for index in spread(len(split.images[name]), most):
        views = [round(column * VIEWS / columns) for column in range(columns)]
        row = [on_paper(torch.from_numpy(split.images[name][index, view].copy())) for view in views]
        if name in split.voxels:
            solid = voxel_surface(torch.from_numpy(split.voxels[name][index].copy()))
            row += [draw_mesh(*solid, view, VOXEL_COLOR) for view in (views[1], views[-2])]
        rows.append(torch.cat(row, 2))
    return torch.cat(rows, 1)


def spread(count: int, most: int) -> list[int]:
    """Up to ``most`` of ``count`` numbers, evenly spread."""
    return sorted({round(index * (count - 1) / max(min(most, count) - 1, 1)) for index in range(min(most, count))})


@torch.no_grad()
def prediction_sheet(
    predictors: dict[str, Predictor], split: Split, each: int = 2, size: int = 96, turns: tuple[int, ...] = (0, 5, 12)
) -> Tensor:
    """A few objects of each class: an input; of each predictor, the shape from three views; the voxels to be found.

    The views are the input's own, and ``turns`` further around. A row for each object below a line that names the
    columns: [3, 20 + rows · size, columns · size] in [0, 1].
    """
    rows = []
    for number, name in enumerate(split.classes):
        for index in spread(len(split.images[name]), each):
            view = (7 * number + 5 * index + 2) % VIEWS
            image = torch.from_numpy(split.images[name][index, view].copy())
            truth = Solids(torch.from_numpy(split.voxels[name][index].copy())[None])
            predictions = [predict(image[None]) for predict in predictors.values()]
            row = [torch.nn.functional.interpolate(on_paper(image)[None], (size, size), mode="bilinear")[0]]
            for shapes in (*predictions, truth):
                row += [shapes.picture(0, (view + turn) % VIEWS, size).cpu() for turn in turns]
            rows.append(torch.cat(row, 2))
    titles = ["input", *(title for name in (*predictors, "truth") for title in (name, *[""] * (len(turns) - 1)))]
    return torch.cat((_header(titles, size), *rows), 1)


@torch.no_grad()
def training_sheet(predict: Predictor, split: Split, most: int = 13, turns: tuple[int, ...] = (0, 6, 15)) -> Tensor:
    """The first object of each of up to ``most`` classes, for which no voxels are needed: the input; the prediction
    from views that are ``turns`` further around; and the object's images from there.

    [3, rows · 64, (1 + 2 · len(turns)) · 64] in [0, 1].
    """
    rows = []
    for number, name in enumerate(split.classes[:most]):
        images = torch.from_numpy(split.images[name][0].copy())
        look = (7 * number + 2) % VIEWS
        views = [(look + turn) % VIEWS for turn in turns]
        shapes = predict(images[look][None])
        row = [on_paper(images[look])] + [shapes.picture(0, view, SIZE).cpu() for view in views]
        rows.append(torch.cat(row + [on_paper(images[view]) for view in views], 2))
    return torch.cat(rows, 1)


def _header(titles: Sequence[str], size: int, height: int = 20) -> Tensor:
    """A line [3, height, columns · size] with a title above each column that has one."""
    image = Image.new("L", (len(titles) * size, height), round(255 * PAPER))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(12)
    for column, title in enumerate(titles):
        draw.text((column * size + 4, 3), title, 40, font)
    return (torch.from_numpy(np.array(image)).float() / 255).expand(3, -1, -1)
