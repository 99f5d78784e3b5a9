"""Options of `neural-renderer reconstruct dataset`."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class DatasetOptions:
    """Render and voxelise a folder of 3D models: the data set for train and evaluate.

    MODELS contains a folder per category, with mesh files or, as in ShapeNetCore, a folder per model with model.obj or
    models/model_normalized.obj. The y axis of models is up. OUT gets {class}_{split}_images.npz,
    {class}_{split}_voxels.npz, dataset.json, and contact sheets. Broken models are reported and skipped.

    Example: neural-renderer reconstruct dataset models data --splits models/splits.csv

    Example: neural-renderer reconstruct dataset other_models other_data --set test

    Ctrl-C keeps finished objects; the same command continues. Afterwards, OUT/objects may be deleted.
    """

    models: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODELS")]
    """Folder of the models."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the data set; it is made if missing."""
    splits: Path | None = None
    """CSV file with the columns category, model and split (train, val or test). Models that it does not list are
    skipped. Without --splits and --set, 70 % of each category are for train, 10 % for val and 20 % for test."""
    set: Literal["train", "val", "test"] | None = None
    """Put all models into this split."""
    views: int = 24
    """Views around each object (at least 1). train and evaluate need 24."""
    size: int = 64
    """Side of the views in pixels (at least 8). train and evaluate need 64."""
    samples: int = 6
    """Samples along each side of a pixel (at least 4)."""
    allow_outside: bool = False
    """Allow mesh files to name materials and images outside of their folders, as ShapeNetCore.v2 does. For trusted
    models only."""
    processes: Annotated[int, tyro.conf.arg(aliases=["-j"])] = field(default_factory=lambda: os.cpu_count() or 1)
    """Worker processes, one model each (0: none)."""
