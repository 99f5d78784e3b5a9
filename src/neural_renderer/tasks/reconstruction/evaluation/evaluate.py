"""Evaluation of single-image reconstruction like the paper's Table 1 (section 5.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor

from ....metrics import silhouette_iou
from ..data.arrays import Split
from ..data.framing import VIEWS
from ..data.voxels import chamfer, voxel_iou
from .predictors import Predictor

MEASURES = ("voxel_iou", "silhouette_iou", "chamfer")
_AROUND = (0, 6, 12, 18)  # views to compare, relative to that of the input


@dataclass
class Scores:
    """Measures of a method, by class and object. Each number is the mean over the 24 input views.

    "voxel_iou" is at 32³. "silhouette_iou" is the mean over the input's view and those at 90°, 180° and 270° from it,
    at 64 pixels. "chamfer" is the distance of `voxels.chamfer`, for a longest side of 1.

    Attributes:
        objects: Class → object → measure → value.
    """

    objects: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)

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
