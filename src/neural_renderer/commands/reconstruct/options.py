"""Options of the commands of `neural-renderer reconstruct`, like `commands.options`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...tasks.settings import ConfigName, ModelName
from ..options import Device, Engine, EngineOptions, Output, Watch, WatchOptions


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
    engine: Engine = field(default_factory=EngineOptions)


@dataclass(frozen=True)
class TrainOptions:
    """Train a network for single-image reconstruction from images only.

    DATA is a folder written by `neural-renderer reconstruct dataset`, or the published data set. The split "train" is
    used for training and "val" for validation. OUT gets last.ckpt (for --resume), best.ckpt (the best network on
    "val"), log.csv, pictures of predictions, and logs for TensorBoard.

    Example: neural-renderer reconstruct train data out --config small

    Example: neural-renderer reconstruct train data out --config paper --classes chair --minutes 30

    Example: torchrun --nnodes 2 --nproc-per-node 4 --rdzv-endpoint HOST:29500 -m neural_renderer.cli reconstruct train
    data out --nodes 2 --devices 4

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
    steps: int | None = None
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
    every: int = 250
    """Steps between two validations, checkpoints and pictures (at least 1)."""
    seed: int = 0
    """Seed of the initial weights and of the batches."""
    resume: bool = False
    """Resume from last.ckpt in OUT, if there is one."""
    devices: int = 1
    """Processes on this machine, each with a GPU if there are GPUs. All processes share each batch."""
    nodes: int = 1
    """Number of machines, started by torchrun or SLURM."""
    device: Device = "auto"
    precision: Literal["auto", "32", "bf16"] = "auto"
    """Precision of the networks. auto is bfloat16 if the configuration allows it and the hardware is fast at it."""
    workers: int = 0
    """Processes that load images ahead. Slow disks need some."""
    watch: Watch = field(default_factory=WatchOptions)


@dataclass(frozen=True)
class EvaluateOptions:
    """Evaluate networks by class: voxel IoU at 32³ as in the paper's Table 1, silhouette IoU, chamfer distance.

    Each object of a split is predicted from each of its 24 views. CHECKPOINT is a file written by train, of a mesh or
    a voxel network; "none" evaluates the baseline only. Results are scores.json, table.md, and sheet.png with inputs,
    predictions from three views, and the true voxels. Ctrl-C keeps the methods that are finished.

    Example: neural-renderer reconstruct evaluate trained/best.ckpt data

    Example: neural-renderer reconstruct evaluate mesh/best.ckpt data --also voxel/best.ckpt --baseline retrieval
    --features googlenet
    """

    checkpoint: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    """Checkpoint of the network, or "none"."""
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
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; by default "evaluation_" and the name of the split, beside the checkpoint."""
    device: Device = "auto"


@dataclass(frozen=True)
class PredictOptions:
    """Predict a mesh from a picture of an object with a trained network.

    A picture is a PNG with transparency, a photo with a --mask, or an object in front of a plain background. The object
    is cut out and framed like the training images; several sizes are tried, and the best one is used. A
    square of 64 pixels with transparency is used unchanged. The mesh has y up and a longest side of about 1. Beside it
    are written a contact sheet (_sheet.png) of the picture, the network's input and views of the mesh, and a turntable
    (_turntable.gif).

    Example: neural-renderer reconstruct predict trained/best.ckpt chair.png -o chair.obj

    Example: neural-renderer reconstruct predict trained/best.ckpt photo.jpg --mask mask.png -o chair.glb

    Example: neural-renderer reconstruct predict trained/best.ckpt photos/*.png -o meshes
    """

    checkpoint: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    """Checkpoint of a mesh or voxel network."""
    images: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="IMAGE")]
    """One or more pictures."""
    output: Output
    """Mesh to write: .obj, .glb or .ply; for several pictures a folder. It is made if missing."""
    mask: Path | None = None
    """Picture that is white, or opaque, on the object; for several pictures a folder of masks with the same names."""
    format: Literal["obj", "glb", "ply"] = "obj"
    """Format of the meshes in a folder."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    sheet: bool = True
    """Write a contact sheet."""
    threshold: float = 0.5
    """Probability (above 0, below 1) at the surface of a voxel network's prediction."""
    refine: int | None = None
    """Steps of test-time refinement (0: none); by default the configuration's. Refinement fits a predicted mesh to the
    silhouette of its image."""
    force: bool = False
    """Replace meshes of these pictures in the output folder, from an earlier run. A mesh file that --output names is
    replaced anyway."""
    device: Device = "auto"
    watch: Watch = field(default_factory=WatchOptions)
