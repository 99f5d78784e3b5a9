"""Options of `neural-renderer reconstruct evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


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
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device to compute on; auto is CUDA if available."""
