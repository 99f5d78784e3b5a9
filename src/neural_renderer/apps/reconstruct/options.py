"""Options of the commands of `neural-renderer reconstruct`. This module does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...base.requirements import require_library
from ..common.checks import check_between, check_counts, check_folder, check_input_folder, check_inputs
from ..common.options import AllowOutside, Device, Output, Steps, Watch, WatchOptions
from ..many.options import Engine, EngineOptions
from .settings import SIZE, VIEWS, ConfigName, ModelName, RunSettings

_MODELS = "a folder with a folder of models per category"
_DATA = "a folder with a data set"


def _check_minutes(minutes: float | None) -> None:
    if minutes is not None:
        check_between("minutes", minutes, 0, math.inf)


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
    views: int = VIEWS
    """Views around each object (at least 1). train and evaluate need 24."""
    size: int = SIZE
    """Side of the views in pixels (at least 8). train and evaluate need 64."""
    samples: int = 6
    """Samples per pixel along each axis (at least 4)."""
    allow_outside: AllowOutside = False
    engine: Engine = field(default_factory=EngineOptions)

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit, missing inputs, and an unwritable output."""
        check_counts(self, views=1, size=8, samples=4)
        self.engine.validate()
        if self.engine.shard is not None:
            raise ValueError("--shard: expected none, as the last step needs all objects; --engine ray uses a cluster")
        if self.splits is not None and self.set is not None:
            raise ValueError("--set: expected only one of --set and --splits, got both")
        check_input_folder(self.models, _MODELS)
        check_inputs(self.splits)
        check_folder("OUT", self.out)


@dataclass(frozen=True)
class TrainOptions:
    """Train a network for single-image reconstruction from images only.

    DATA is a folder written by `neural-renderer reconstruct dataset`, or the published data set. The split "train" is
    used for training and "val" for validation. OUT gets last.ckpt (for --resume), best.ckpt (the best network on
    "val"), log.csv, pictures of predictions, and logs for TensorBoard.

    Example: neural-renderer reconstruct train data out --config small

    Example: neural-renderer reconstruct train data out --config paper --classes chair --minutes 30

    Example: torchrun --nnodes 2 --nproc-per-node 4 --rdzv-endpoint HOST:29500 -m neural_renderer reconstruct train data
    out --nodes 2 --devices 4

    Ctrl-C ends the training after the current step and keeps it.
    """

    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")]
    """Folder of the data set."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the results; it is made if missing."""
    model: ModelName = "mesh"
    """Network. mesh: deform a sphere (the paper's method); voxel: predict voxels (the baseline of Yan et al. 2016)."""
    config: ConfigName = "best"
    """Configuration. paper: the paper's, a million steps that take days; best: the best one known for a short training;
    small: the same with fewer steps (15 minutes on one core)."""
    classes: tuple[str, ...] = ()
    """Classes to train on; by default all."""
    steps: Annotated[int | None, Steps] = None
    """Number of steps (at least 1); by default the configuration's."""
    minutes: float | None = None
    """Time limit. The learning-rate schedule ends at this time."""
    features: str | None = None
    """Replace the configuration's encoder by a frozen recognition network: googlenet (downloaded once), or a file of
    weights. This helps most with few training objects."""
    smoothness: float | None = None
    """Weight of the smoothness loss; by default the configuration's."""
    laplacian: float | None = None
    """Weight of the Laplacian loss; by default the configuration's."""
    blur: float | None = None
    """Strength of the smoothing of vertex displacements (0: none); by default the configuration's."""
    every: int = RunSettings.every
    """Steps between two validations, checkpoints and pictures (at least 1)."""
    seed: int = RunSettings.seed
    """Seed of the initial weights and of the batches."""
    resume: bool = False
    """Resume from last.ckpt in OUT, if there is one."""
    devices: int = RunSettings.devices
    """Processes on this machine, each with a GPU if there are GPUs. All processes share each batch."""
    nodes: int = RunSettings.nodes
    """Number of machines, started by torchrun or SLURM."""
    device: Device = RunSettings.device
    precision: Literal["auto", "32", "bf16"] = "auto"
    """Precision of the networks. auto is bfloat16 if the configuration allows it and the hardware is fast at it."""
    workers: int = RunSettings.workers
    """Processes that load images ahead. Slow disks need some."""
    watch: Watch = field(default_factory=WatchOptions)

    def validate(self) -> None:
        """Raise an error for options that are out of range, missing data or libraries, and an unwritable output."""
        check_counts(self, every=1, seed=0, devices=1, nodes=1, workers=0, steps=1)
        _check_minutes(self.minutes)
        for name in ("smoothness", "laplacian", "blur"):
            weight = getattr(self, name)
            if weight is not None and not 0 <= weight < math.inf:
                raise ValueError(f"--{name}: expected a number of at least 0, got {weight}")
        check_input_folder(self.data, _DATA)
        for library in ("lightning", "tensorboard"):
            require_library(library, "to train networks")
        self.watch.validate()
        check_folder("OUT", self.out)


@dataclass(frozen=True)
class EvaluateOptions:
    """Evaluate networks by class: voxel IoU at 32³ as in the paper's Table 1, silhouette IoU, chamfer distance.

    Each object of a split is predicted from each of its 24 views. CHECKPOINT is a file written by train, of a mesh or
    a voxel network, or "shipped"; "none" evaluates the baseline only. Results are scores.json, table.md, and sheet.png
    with inputs, predictions from three views, and the true voxels. Ctrl-C keeps the methods that are finished.

    Example: neural-renderer reconstruct evaluate trained/best.ckpt data

    Example: neural-renderer reconstruct evaluate mesh/best.ckpt data --also voxel/best.ckpt --baseline retrieval
    --features googlenet
    """

    checkpoint: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    """Checkpoint of the network; "shipped" for the network of the package, evaluated with unknown cameras, with known
    cameras but unknown azimuths, and with known views; or "none"."""
    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")]
    """Folder of the data set, written by dataset or published."""
    set: Literal["train", "val", "test"] = "test"
    """Split to evaluate on."""
    also: tuple[Path, ...] = ()
    """Checkpoints of further networks for the same table."""
    baseline: Literal["retrieval"] | None = None
    """Evaluate a baseline, too. retrieval: the voxels of the most similar training image."""
    features: str | None = None
    """Feature network of the baseline: vgg16 (layer fc6, as in the paper), googlenet (the default), or a file with the
    weights of either. Named networks are downloaded once."""
    refine: int | None = None
    """Steps of test-time refinement (0: none); by default the configuration's. Refinement fits a predicted mesh to the
    silhouette of its image."""
    classes: tuple[str, ...] = ()
    """Classes to evaluate; by default all."""
    threshold: float = 0.5
    """Threshold of a voxel network: voxels of a higher probability are filled (above 0, below 1)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--out"])] = None
    """Folder for the results; by default "evaluation_" and the name of the split, in the folder of the checkpoint, or
    in DATA for "shipped"."""
    device: Device = "auto"

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit, missing inputs, and an unwritable output."""
        check_between("threshold", self.threshold, 0, 1)
        check_counts(self, refine=0)
        if self.checkpoint == "none" and not (self.also or self.baseline):
            raise ValueError("checkpoint: expected a network or --baseline retrieval, got neither")
        if self.features is not None and not self.baseline:
            raise ValueError(f"--features: expected --baseline retrieval with it, got {self.features} alone")
        check_input_folder(self.data, _DATA)
        check_inputs(None if self.checkpoint in ("none", "shipped") else Path(self.checkpoint), *self.also)
        if self.output is not None:
            check_folder("--output", self.output)


@dataclass(frozen=True)
class PretrainOptions:
    """Train the network that the package ships: one picture to voxels, category and view, on generated shapes.

    Shapes are built from random parts and drawn while training; no data set is needed. With --models, half of them are
    deformed models of the split "train". OUT gets shapes.ckpt (for --resume), weights.pt (for predict) and log.csv.

    Example: neural-renderer reconstruct pretrain out --models models --splits models/splits.csv

    Example: neural-renderer reconstruct pretrain out --minutes 20

    Ctrl-C ends the training; the state of the last --every steps is kept.
    """

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder for the results; it is made if missing."""
    steps: Annotated[int, Steps] = 20_000
    """Number of steps (at least 1). The learning rate falls to 0 with the last one."""
    minutes: float | None = None
    """Time limit, with what --resume continues. The learning-rate schedule ends at this time."""
    models: Path | None = None
    """Folder of models with a folder per category, as for dataset."""
    splits: Path | None = None
    """CSV file with the columns category, model and split. Without it, 70 % of each category are for training."""
    data: Path | None = None
    """Data set whose split "val" is measured every --every steps."""
    every: int = RunSettings.every
    """Steps between two checkpoints (at least 1)."""
    seed: int = 0
    """Seed of the shapes and of the initial weights."""
    resume: bool = False
    """Resume from shapes.ckpt in OUT, if there is one."""

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit, missing inputs, and an unwritable output."""
        check_counts(self, steps=1, every=1, seed=0)
        _check_minutes(self.minutes)
        if self.models is None and self.splits is not None:
            raise ValueError("--splits: expected --models with it, got it alone")
        if self.models is not None:
            check_input_folder(self.models, _MODELS)
        check_inputs(self.splits)
        if self.data is not None:
            check_input_folder(self.data, _DATA)
        check_folder("OUT", self.out)


@dataclass(frozen=True)
class PredictOptions:
    """Predict a coloured mesh from a picture of an object.

    A picture is a PNG with transparency, a photo with a --mask or a --box, or an object in front of a plain background.
    The network that comes with the package knows airplanes, beds, benches, blasters (toy guns), cabinets, cars, chairs,
    displays, lamps, rifles, sofas, tables and watercraft. The mesh has y up, its front at +z and a longest side of
    about 1. The command also writes a contact sheet (_sheet.png) with the picture, the network's input and views
    of the mesh, and a turntable (_turntable.gif).

    Example: neural-renderer reconstruct predict photo.jpg -o out

    Example: neural-renderer reconstruct predict street.jpg --box 0.2 0.4 0.7 0.9 -o car.glb

    Example: neural-renderer reconstruct predict photos/*.png -o meshes

    Example: neural-renderer reconstruct predict chair.png -o chair.obj --checkpoint trained/best.ckpt
    """

    images: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="IMAGE")]
    """One or more pictures, or folders of pictures."""
    output: Output
    """Mesh to write: .obj, .glb or .ply; or a folder. It is made if missing."""
    mask: Path | None = None
    """Picture that is white, or opaque, on the object; for several pictures a folder of masks with the same names."""
    box: tuple[float, float, float, float] | None = None
    """Left, top, right and bottom of a box around the object, as fractions of the sides, for busy backgrounds."""
    azimuth: float | None = None
    """Direction from which the pictures were taken, in degrees around the object: 180 in front of it, 90 to the right
    as seen from the front, 0 behind it. By default it is predicted."""
    checkpoint: Path | None = None
    """Another network: a .ckpt file of train, or a .pt file of pretrain."""
    format: Literal["obj", "glb", "ply"] = "glb"
    """Format of the meshes in a folder."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    sheet: bool = True
    """Write a contact sheet."""
    threshold: float | None = None
    """Probability (above 0, below 1) at the surface of the prediction of a voxel network of train; by default 0.5. The
    shipped network chooses it automatically."""
    refine: int | None = None
    """Steps of test-time refinement (0: none); by default 30, or those of the checkpoint's configuration. Refinement
    fits a predicted mesh to the silhouette of its image."""
    force: bool = False
    """Replace meshes of these pictures in the output folder, from an earlier run. A mesh file that --output names is
    replaced anyway."""
    device: Device = "auto"
    watch: Watch = field(default_factory=WatchOptions)

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit, missing inputs, and an unwritable output."""
        check_counts(self, turntable=0, refine=0)
        if self.threshold is not None:
            check_between("threshold", self.threshold, 0, 1)
        if self.mask is not None and self.box is not None:
            raise ValueError("--box: expected either a box or a mask, got both")
        if len(self.images) == 1 and not self.images[0].is_dir():  # of several, the others are predicted
            check_inputs(*self.images)
        check_inputs(self.checkpoint, None if self.mask is None or self.mask.is_dir() else self.mask)
        self.watch.validate()
        check_folder("--output", self.output if not self.output.suffix else self.output.parent)
