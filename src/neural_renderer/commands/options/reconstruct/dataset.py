"""Options of `neural-renderer reconstruct dataset`."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class DatasetOptions:
    """Render a folder of 3D models from all around, and voxelise them: the data for train and evaluate.

    MODELS has a folder per category, with mesh files in it or, as ShapeNetCore has, a folder per model with model.obj
    or models/model_normalized.obj. OUT gets {class}_{split}_images.npz, {class}_{split}_voxels.npz, dataset.json, and
    sheets to look at. Models are taken as y up; a broken one is named and left out.

    Example: neural-renderer reconstruct dataset models data --splits models/splits.csv

    Example: neural-renderer reconstruct dataset other_models other_data --set test

    Ctrl-C keeps the objects that are done; the same command goes on. OUT/objects is only for that: once all is well,
    it may go.
    """

    models: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODELS")]
    """Folder of the models."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the data; it is made if missing."""
    splits: Path | None = None
    """CSV with the columns category, model and split (train, val or test); models that it lacks are left out. Without
    it and --set, 70 % of each category go to train, 10 % to val and 20 % to test."""
    set: Literal["train", "val", "test"] | None = None
    """Put all models into this split."""
    views: int = 24
    """Views around each object (at least 1); train and evaluate take 24."""
    size: int = 64
    """Width and height of the views in pixels (at least 8); train and evaluate take 64."""
    samples: int = 6
    """Each pixel is the mean of so many times so many (at least 4)."""
    allow_outside: bool = False
    """Read materials and images outside a mesh file's folder too, if it names such, as those of ShapeNetCore.v2 do; for
    models that you trust."""
    processes: Annotated[int, tyro.conf.arg(aliases=["-j"])] = field(default_factory=lambda: os.cpu_count() or 1)
    """Models that are worked on at once, each in a process of its own (0: one after the other, in this process)."""
