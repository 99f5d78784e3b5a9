"""Options of `neural-renderer reconstruct evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class EvaluateOptions:
    """Measure trained networks by class: voxel IoU at 32³ as in the paper's Table 1, silhouette IoU, chamfer distance.

    Every object of a split is predicted from each of its 24 views. CHECKPOINT is what train has written, of a mesh or
    of a voxel network; "none" measures the baseline alone. Written to the output folder: scores.json, table.md, and
    sheet.png with an input, each method's prediction from three views, and the true voxels. Ctrl-C keeps the
    methods that are done.

    Example: neural-renderer reconstruct evaluate trained/best.ckpt data

    Example: neural-renderer reconstruct evaluate mesh/best.ckpt data --also voxel/best.ckpt --baseline retrieval
    --features googlenet
    """

    checkpoint: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    """The trained network, or "none"."""
    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")]
    """Folder that dataset has written, or the published one."""
    set: Literal["train", "val", "test"] = "test"
    """The split to measure on."""
    also: tuple[Path, ...] = ()
    """Further networks, for rows of their own in the same table."""
    baseline: Literal["retrieval"] | None = None
    """Measure too how well the voxels of the most alike training image do."""
    features: str | None = None
    """The network that says what is alike to the baseline: vgg16 (its layer fc6, as in the paper) or googlenet (the
    default), which are fetched once, or a file of weights of either."""
    refine: int | None = None
    """Steps by which a predicted mesh is fitted to the silhouette that went in, in place of the recipe's (0: none)."""
    classes: tuple[str, ...] = ()
    """Measure these classes only (default: all there are)."""
    threshold: float = 0.5
    """The probability (above 0, below 1) from which on a voxel network's voxels are solid."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; by default "evaluation", with the split's name, beside the checkpoint."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""
