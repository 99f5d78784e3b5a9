"""Options of `neural-renderer reconstruct train`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ....tasks.settings import ConfigName, ModelName
from ..watch import WatchOptions


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
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device to compute on; auto is CUDA if available."""
    precision: Literal["auto", "32", "bf16"] = "auto"
    """Precision of the networks. auto is bfloat16 if the configuration allows it and the hardware is fast at it."""
    workers: int = 0
    """Processes that load images ahead. Slow disks need some."""
    watch: Annotated[WatchOptions, tyro.conf.arg(name="")] = field(default_factory=WatchOptions)
    """Follow the run."""
