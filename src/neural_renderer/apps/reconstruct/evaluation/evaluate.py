"""Evaluation of single-image reconstruction, and tables of scores in the layout of the paper's Table 1 (section 5.1).

A table has a row per method, blocks of seven classes, and the mean last.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import torch
from rich import box
from rich.table import Table
from torch import Tensor

from ....optim.metrics import silhouette_iou
from ..data.arrays import Split
from ..data.framing import VIEWS
from ..data.voxels import chamfer, voxel_iou
from .predictors import Predictor

MEASURES = ("voxel_iou", "silhouette_iou", "chamfer")
_AROUND = (0, 6, 12, 18)  # views to compare, relative to that of the input
_COLUMNS = 7
_BETTER = {"voxel_iou": max, "silhouette_iou": max, "chamfer": min}
TITLES = {
    "voxel_iou": "Voxel IoU at 32³ (higher is better)",
    "silhouette_iou": "Silhouette IoU at 64 pixels (higher is better)",
    "chamfer": "Chamfer distance of surfaces, longest side 1 (lower is better)",
}


@dataclass
class Scores:
    """Measures of a method, by class and object. Each number is the mean over the 24 input views.

    "voxel_iou" is at 32³. "silhouette_iou" is the mean over the input's view and those at 90°, 180° and 270° from it,
    at 64 pixels. "chamfer" is the distance of `voxels.chamfer`, for a longest side of 1.
    """

    objects: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)  # class → object → measure → value

    def of_class(self, name: str, measure: str = "voxel_iou") -> float:
        """Compute the mean over the objects of a class."""
        values = [row[measure] for row in self.objects[name].values()]
        return sum(values) / len(values)

    def mean(self, measure: str = "voxel_iou") -> float:
        """Compute the mean over classes."""
        return sum(self.of_class(name, measure) for name in self.objects) / len(self.objects)

    def to_dict(self) -> dict[str, object]:
        """Convert to a dictionary for JSON."""
        classes = {name: {measure: self.of_class(name, measure) for measure in MEASURES} for name in self.objects}
        return {
            "mean": {measure: self.mean(measure) for measure in MEASURES},
            "classes": classes,
            "objects": self.objects,
        }


def evaluate(
    predict: Predictor, split: Split, device: torch.device | str = "cpu"
) -> Iterator[tuple[str, str, dict[str, float]]]:
    """Predict each object of a split from each of its views, and measure the predictions.

    Yields class, object and measures (see `Scores`) of each object. Raises FileNotFoundError if a class has no voxels.
    """
    for name in split.classes:
        if name not in split.voxels:
            path = split.folder / f"{name}_{split.split}_voxels.npz"
            raise FileNotFoundError(f"{path}: expected the voxels to compare with, got nothing there")
    for name in split.classes:
        for index, label in enumerate(split.names[name]):
            images = torch.from_numpy(split.images[name][index].copy()).to(device)
            truth = torch.from_numpy(split.voxels[name][index].copy()).to(device)
            yield name, label, measure(predict, images, truth)


@torch.no_grad()
def measure(predict: Predictor, images: Tensor, truth: Tensor) -> dict[str, float]:
    """Measure the predictions of one object from images [24, 4, 64, 64] uint8 against voxels [32, 32, 32] bool."""
    predictions = predict(images)
    voxels = predictions.voxels()
    views = torch.arange(VIEWS, device=images.device)[:, None] + torch.tensor(_AROUND, device=images.device)
    views = views % VIEWS
    silhouettes = predictions.silhouettes(views).flatten(0, 1)
    masks = (images[:, 3] > 127)[views].flatten(0, 1)
    return {
        "voxel_iou": float(voxel_iou(voxels, truth.expand_as(voxels)).mean()),
        "silhouette_iou": float(silhouette_iou(silhouettes > 0.5, masks).mean()),
        "chamfer": float(chamfer(voxels, truth[None]).mean()),
    }


def blocks(
    methods: Mapping[str, Scores], measure: str = "voxel_iou", columns_each: int = _COLUMNS
) -> list[list[list[str]]]:
    """Lay out a table in blocks of classes; each has rows of cells: a header, then a row per method.

    The best value of a column is marked with ``**``.
    """
    classes = list(next(iter(methods.values())).objects)
    columns = [(name, {label: scores.of_class(name, measure) for label, scores in methods.items()}) for name in classes]
    columns.append(("mean", {label: scores.mean(measure) for label, scores in methods.items()}))
    parts = [columns[begin : begin + columns_each] for begin in range(0, len(columns), columns_each)]
    if len(parts) > 1 and len(parts[-1]) == 1:  # a block has more than the mean, as in the paper
        parts[-2:] = [parts[-2] + parts[-1]]
    return [
        [["", *(name for name, _ in part)]]
        + [[label, *(_cell(values, label, measure) for _, values in part)] for label in methods]
        for part in parts
    ]


def _cell(values: Mapping[str, float], label: str, measure: str) -> str:
    """Format the value of a method; the best one gets ``**``."""
    text = f"{values[label]:.4f}"
    best = f"{_BETTER[measure](values.values()):.4f}"
    return f"**{text}**" if len(values) > 1 and text == best else text


def markdown(methods: Mapping[str, Scores]) -> str:
    """Format tables of all measures as Markdown."""
    text = []
    for measure, title in TITLES.items():
        text.append(f"{title}\n")
        for header, *rows in blocks(methods, measure):
            lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
            text.append("".join("| " + " | ".join(line) + " |\n" for line in lines))
    return "\n".join(text)


def terminal(methods: Mapping[str, Scores], width: int = 80) -> list[Table]:
    """Format the voxel IoU for a terminal of ``width`` characters, a table per block."""
    for columns_each in range(_COLUMNS, 0, -1):
        parts = blocks(methods, "voxel_iou", columns_each)
        if all(
            sum(max(len(c.strip("*")) for c in column) + 3 for column in zip(*p, strict=True)) <= width for p in parts
        ):
            break
    tables = []
    for number, (header, *rows) in enumerate(parts):
        title = TITLES["voxel_iou"] if number == 0 else None
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
        for index, name in enumerate(header):
            table.add_column(name, justify="right" if index else "left", no_wrap=True)
        for row in rows:
            table.add_row(*(f"[bold]{cell[2:-2]}[/bold]" if cell.startswith("**") else cell for cell in row))
        tables.append(table)
    return tables
