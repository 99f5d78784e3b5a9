"""Options of `neural-renderer finish`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ...base.requirements import require_library
from ..common.checks import (
    CHECKPOINT,
    REPORT,
    check_counts,
    check_earlier,
    check_folder,
    check_inputs,
    check_most,
    check_outputs,
)
from ..common.options import AllowOutside, Output, Steps, Watch, WatchOptions

SUFFIXES = (".glb", ".obj")
_OTHERS = (".gltf", ".ply", ".stl", ".off")  # suffixes of meshes that are not written
SHEET = "sheet.png"
LEAST_FACES = 4


@dataclass(frozen=True, kw_only=True)
class FinishOptions:
    """Make a light mesh that looks like a heavy one: fewer faces, charts, images of colours, materials and normals.

    MESH may have colours at vertices, images, or several parts and materials. The steps: clean the mesh; reduce its
    faces; make charts; transfer the look of the original to images; move vertices and improve the images by the
    gradient of the difference in drawings, as long as other views gain, too.

    Example: neural-renderer finish big.glb -o small.glb

    Example: neural-renderer finish scan.ply -o levels --faces 100000 25000 5000 --size 4096 --steps 0

    Ctrl-C ends the improvement and writes the best mesh so far; --resume continues it.
    """

    mesh: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Output
    """File for the mesh, .glb or .obj; its report, a sheet and the checkpoint go to the folder of that name, such as
    small for small.glb. Or a folder for all of them, with mesh.glb. Several levels are called small_25000.glb."""
    faces: tuple[int, ...] = (50000,)
    """Number of faces (at least 4), or several for levels of detail."""
    lod: bool = False
    """Write several levels to the output as well, as one GLB file with MSFT_lod."""
    size: int | None = None
    """Side of the images in pixels (16 to 8192); without it 2048, or with --keep-uv that of the images in MESH."""
    gutter: int = 4
    """Least distance of two charts in pixels (at least 1)."""
    keep_uv: bool = False
    """Keep charts, materials and images of MESH; images larger than --size shrink, holes stay open."""
    keep_inside: bool = False
    """Keep connected parts that no view from outside sees."""
    pieces: float = 0.005
    """Remove connected parts shorter than this share of the mesh (0: none), unless they are 1 % of its area."""
    holes: float = 0.02
    """Close holes shorter than this share of the mesh (0: none)."""
    steps: Annotated[int, Steps] = 60
    """Steps of improvement for each level (0: none)."""
    views: int = 24
    """Views for the improvement (at least 4); others measure it."""
    pixels: int = 384
    """Side of their pictures in pixels (at least 64)."""
    allow_outside: AllowOutside = False
    resume: bool = False
    """Resume the improvement from its checkpoint, if there is one. Mesh and options must be the same."""
    force: bool = False
    """Replace the results of an earlier run."""
    watch: Watch = field(default_factory=WatchOptions)

    def validate(self) -> None:
        """Raise an error for options out of range, missing files or libraries, and an unwritable output."""
        check_counts(self, size=16, gutter=1, pieces=0, holes=0, steps=0, views=4, pixels=64)
        check_most(self, size=8192)
        for name, value, most in (("pieces", self.pieces, 0.5), ("holes", self.holes, 1.0)):
            if value > most:
                raise ValueError(f"--{name}: expected at most {most:g}, got {value}")
        if not self.faces or min(self.faces) < LEAST_FACES:
            raise ValueError(f"--faces: expected numbers of at least {LEAST_FACES}, got {list(self.faces)}")
        if len(set(self.faces)) < len(self.faces):
            raise ValueError(f"--faces: expected numbers that differ, got {list(self.faces)}")
        if self.output.suffix.lower() in _OTHERS:
            raise ValueError(
                f"--output: expected a name that ends in {' or '.join(SUFFIXES)}, or a folder, got {self.output.name!r}"
            )
        if self.lod and (len(self.faces) < 2 or self.levels_file.suffix.lower() != ".glb"):
            raise ValueError("--lod: expected several --faces and an output that ends in .glb")
        check_inputs(self.mesh)
        require_library("opengl_decimate", "to reduce faces")
        made = (("fast_simplification", "to reduce faces"), ("xatlas", "to make charts"))
        for library, use in () if self.keep_uv else made:
            require_library(library, use)
        self.watch.validate()
        check_folder("--output", self.folder)
        check_earlier(self.folder, self.resume, self.force, self.files()[: len(self.faces) + self.lod])
        check_outputs(self.files(), [self.mesh])

    @property
    def folder(self) -> Path:
        """Folder of the report, the sheets and the checkpoint."""
        return self.output.with_suffix("") if self.output.suffix.lower() in SUFFIXES else self.output

    def level_folder(self, count: int) -> Path:
        """Return the folder of the sheet and the checkpoint of a level."""
        return self.folder / str(count) if len(self.faces) > 1 else self.folder

    @property
    def levels_file(self) -> Path:
        """File of the only mesh, or of all levels."""
        return self.output if self.output.suffix.lower() in SUFFIXES else self.output / "mesh.glb"

    def mesh_file(self, count: int) -> Path:
        """Return the file of a level's mesh."""
        file = self.levels_file
        return file.with_stem(f"{file.stem}_{count}") if len(self.faces) > 1 else file

    def files(self) -> list[Path]:
        """List the files that a run writes."""
        of_levels = [
            self.level_folder(count) / name for count in self.faces for name in (SHEET, CHECKPOINT, "preview.png")
        ]
        levels = [self.levels_file] if self.lod else []
        return [*(self.mesh_file(count) for count in self.faces), *levels, *of_levels, self.folder / REPORT]
