"""Options of `neural-renderer reconstruct train`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from ....tasks.settings import ConfigName, ModelName


@dataclass(frozen=True)
class TrainOptions:
    """Train a network that turns one picture of an object into its shape, from pictures of objects alone.

    DATA is a folder that `neural-renderer reconstruct dataset` has written, or the published one. What is learned from
    is the split "train"; what is measured on, "val". OUT gets last.ckpt (after every round of steps; --resume goes on
    from it), best.ckpt (the best on "val"), log.csv, pictures of predictions, and records for TensorBoard.

    Example: neural-renderer reconstruct train data out --config small

    Example: neural-renderer reconstruct train data out --config paper --classes chair --minutes 30

    Example: torchrun --nnodes 2 --nproc-per-node 4 --rdzv-endpoint HOST:29500 -m neural_renderer.cli reconstruct train
    data out --nodes 2 --devices 4

    Ctrl-C ends the training after the step it is at and keeps all of it.
    """

    data: tyro.conf.Positional[Path]
    """Folder of the data."""
    out: tyro.conf.Positional[Path]
    """Folder for the results; it is made if missing."""
    model: ModelName = "mesh"
    """Deform a sphere (the paper's method), or predict voxels (the baseline of Yan et al. 2016)."""
    config: ConfigName = "best"
    """The recipe: the paper's (a million steps: days), the best known one, or "small", that one with fewer steps
    (a quarter of an hour of one core)."""
    classes: tuple[str, ...] = ()
    """Learn these classes only (default: all there are)."""
    steps: int | None = None
    """Steps of the training, in place of the recipe's (at least 1)."""
    minutes: float | None = None
    """End after this time at the latest, and let the learning rate's schedule fit into it."""
    features: str | None = None
    """A network for recognition to look at the pictures with, in place of the recipe's encoder: googlenet, which is
    fetched once, or a file of weights. With few objects to learn from it knows far more than they can teach."""
    smoothness: float | None = None
    """Weight of the smoothness loss, in place of the recipe's."""
    laplacian: float | None = None
    """Weight of the Laplacian loss, likewise."""
    blur: float | None = None
    """How far neighbouring vertices move alike (0: each for itself), likewise."""
    every: int = 250
    """Steps between two measurements, checkpoints and pictures (at least 1)."""
    seed: int = 0
    """Seed of the network's first weights and of the order of the pictures."""
    resume: bool = False
    """Go on from last.ckpt in OUT, if it is there."""
    devices: int = 1
    """Processes on this machine, each with a GPU where there are GPUs; they share the batch."""
    nodes: int = 1
    """Machines, started by torchrun or SLURM."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""
    precision: Literal["auto", "32", "bf16"] = "auto"
    """Of the networks; auto is bfloat16 if the recipe says so and the hardware is made for it."""
    workers: int = 0
    """Processes that read pictures ahead: some on disks that are slow."""
