"""Options of `neural-renderer compare`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..common.checks import check_between, check_counts, check_folder, check_inputs
from ..common.options import AllowOutside, Device

_PICTURES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class CompareOptions:
    """Measure how different two meshes look, and how far apart their surfaces are: for fewer faces, other textures or
    another format.

    Both are drawn from the same views, evenly around the first mesh, in the same light. The exit code is 1 if a limit
    that is given is not kept.

    Example: neural-renderer compare scan.glb small.glb -o sheet.png

    Example: neural-renderer compare scan.glb small.glb --psnr 35 --iou 0.99 --new-holes 0 --json
    """

    first: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FIRST", name="FIRST")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf. The views show all of it."""
    second: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SECOND", name="SECOND")]
    """Mesh file to compare with it, at the same place and of the same size."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--out"])] = None
    """Picture to write, .png or .jpg: both meshes and their difference, from the view with the largest error and from
    others, and the numbers."""
    json: bool = False
    """Print the numbers as JSON."""
    psnr: float | None = None
    """Least PSNR in dB over the pixels that either silhouette covers."""
    iou: float | None = None
    """Least intersection over union of the silhouettes (0 to 1)."""
    ms_ssim: float | None = None
    """Least multi-scale structural similarity of the pictures (0 to 1)."""
    angle: float | None = None
    """Largest mean angle of the normals in degrees (at least 0)."""
    distance: float | None = None
    """Largest mean distance of the surfaces, relative to the longest side of the first mesh (at least 0)."""
    new_holes: int | None = None
    """Holes that the second mesh may have more than the first."""
    views: int = 24
    """Number of views (at least 1)."""
    size: int = 512
    """Side of the pictures in pixels (at least 1)."""
    samples: int = 10000
    """Points on each surface for the distance (at least 1)."""
    shading: Literal["flat", "smooth", "phong", "pbr"] | None = None
    """As for `render`, the same for both. By default smooth if the first mesh has normals or few creases, else flat."""
    layers: int | None = None
    """Number of faces blended at each pixel (at least 1), for transparent and alpha-masked materials. By default all
    faces are opaque."""
    allow_outside: AllowOutside = False
    device: Device = "auto"

    def validate(self) -> None:
        """Raise an error for options that are out of range, and for files that do not exist."""
        check_counts(self, views=1, size=1, samples=1, layers=1, angle=0, distance=0)
        for name, value in (("iou", self.iou), ("ms-ssim", self.ms_ssim)):
            if value is not None and not 0 <= value <= 1:
                raise ValueError(f"--{name}: expected a number from 0 to 1, got {value}")
        if self.psnr is not None:
            check_between("psnr", self.psnr, 0, float("inf"))
        if self.output is not None:
            if self.output.suffix.lower() not in _PICTURES:
                raise ValueError(
                    f"--output: expected a name that ends in {', '.join(_PICTURES)}, got {self.output.name!r}"
                )
            check_folder("--output", self.output.parent)
        check_inputs(self.first, self.second)
