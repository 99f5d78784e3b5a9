"""Options of `neural-renderer reconstruct predict`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class PredictOptions:
    """Turn a picture of an object into a mesh, with a trained network.

    A picture is a PNG with transparency, a photo with a --mask, or an object before a plain background; of any size:
    the object is cut out and framed as the pictures that the network has learned from, at the size at which the
    prediction casts the silhouette that was given. A square of 64 pixels with transparency is taken as it is. Beside
    the mesh (y up, its longest side about 1) there will be a sheet of what was given, what the network saw, and views
    of the mesh (_sheet.png), and a turntable (_turntable.gif).

    Example: neural-renderer reconstruct predict trained/best.ckpt chair.png -o chair.obj

    Example: neural-renderer reconstruct predict trained/best.ckpt photo.jpg --mask mask.png -o chair.glb

    Example: neural-renderer reconstruct predict trained/best.ckpt photos/*.png -o meshes
    """

    checkpoint: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    """The trained network, of meshes or of voxels."""
    images: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="IMAGE")]
    """One or more pictures."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The mesh, .obj, .glb or .ply; for several pictures a folder, which is made if missing."""
    mask: Path | None = None
    """Picture that is white, or opaque, on the object; for several pictures a folder of masks with the same names."""
    format: Literal["obj", "glb", "ply"] = "obj"
    """Of the meshes in a folder."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    sheet: bool = True
    """Write a sheet to look at."""
    threshold: float = 0.5
    """The probability (above 0, below 1) at which the surface of a voxel network's prediction lies."""
    refine: int | None = None
    """Steps by which a mesh is fitted to the silhouette that was given, in place of the recipe's (0: none)."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""
