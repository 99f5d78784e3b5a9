"""Options of `neural-renderer reconstruct predict`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..watch import WatchOptions


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
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
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
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device to compute on; auto is CUDA if available."""
    watch: Annotated[WatchOptions, tyro.conf.arg(name="")] = field(default_factory=WatchOptions)
    """Follow the run."""
