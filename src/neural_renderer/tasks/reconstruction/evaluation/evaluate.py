"""How well shapes are predicted from single images, measured as the paper's Table 1 (section 5.1) measures it."""

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
_AROUND = (0, 6, 12, 18)  # views, from the input's own


@dataclass
class Scores:
    """The measures of one predictor, by class and object; each number is the mean over the 24 input views.

    ``voxel_iou``: at 32³. ``silhouette_iou``: of the prediction from the input's view and from 90°, 180° and 270°
    around, at 64 pixels, above one half. ``chamfer``: see `voxels.chamfer`; the longest side of an object is 1.
    """

    objects: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)

    def of_class(self, name: str, measure: str = "voxel_iou") -> float:
        """The mean over the objects of a class."""
        values = [row[measure] for row in self.objects[name].values()]
        return sum(values) / len(values)

    def mean(self, measure: str = "voxel_iou") -> float:
        """The mean over the classes."""
        return sum(self.of_class(name, measure) for name in self.objects) / len(self.objects)

    def to_dict(self) -> dict[str, object]:
        """As JSON takes it."""
        classes = {name: {measure: self.of_class(name, measure) for measure in MEASURES} for name in self.objects}
        return {
            "mean": {measure: self.mean(measure) for measure in MEASURES},
            "classes": classes,
            "objects": self.objects,
        }


def evaluate(
    predict: Predictor, split: Split, device: torch.device | str = "cpu"
) -> Iterator[tuple[str, str, dict[str, float]]]:
    """Predict every object of a split from each of its views, and score what comes out.

    Yields class, object and measures (see `Scores`) of each in turn. Raises FileNotFoundError if a class has no voxels.
    """
    for name in split.classes:
        if name not in split.voxels:
            path = split.folder / f"{name}_{split.split}_voxels.npz"
            raise FileNotFoundError(f"{path}: expected the voxels to compare with, got nothing there")
    for name in split.classes:
        for index, label in enumerate(split.names[name]):
            images = torch.from_numpy(split.images[name][index].copy()).to(device)
            solid = torch.from_numpy(split.voxels[name][index].copy()).to(device)
            yield name, label, score(predict, images, solid)


@torch.no_grad()
def score(predict: Predictor, images: Tensor, solid: Tensor) -> dict[str, float]:
    """The measures of one object: images uint8 [24, 4, 64, 64], voxels [32, 32, 32] bool."""
    shapes = predict(images)
    voxels = shapes.voxels()
    target = solid.expand_as(voxels)
    views = torch.arange(VIEWS, device=images.device)[:, None] + torch.tensor(_AROUND, device=images.device)
    views = views % VIEWS
    outlines = shapes.silhouettes(views).flatten(0, 1)
    masks = (images[:, 3] > 127)[views].flatten(0, 1)
    return {
        "voxel_iou": float(voxel_iou(voxels, target).mean()),
        "silhouette_iou": float(silhouette_iou(outlines > 0.5, masks).mean()),
        "chamfer": float(chamfer(voxels, solid[None]).mean()),
    }
