"""Options of `neural-renderer dataset` and `neural-renderer batch`. This module does not import torch."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...base.requirements import existing, require_library
from ..common.checks import (
    UsageError,
    check_between,
    check_cameras,
    check_counts,
    check_folder,
    check_inputs,
)
from ..common.options import DEPTH_SCALE, AllowOutside, Output, problem_of_size


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """Execution engine. Results do not depend on it."""

    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: tasks of Ray, on this machine or a cluster (needs the extra "cluster")."""
    processes: Annotated[int, tyro.conf.arg(aliases=["-j"])] = field(default_factory=lambda: os.cpu_count() or 1)
    """Processes of this machine, one model or run each (0: none, and no limits)."""
    address: str | None = None
    """Address of a Ray cluster; auto on one of its nodes. By default Ray is started on this machine."""
    shard: str | None = None
    """Do one part of the work, such as 3/64, the fourth of 64, counted from 0/64: for jobs of a scheduler."""
    time_limit: float = 600.0
    """Time limit of a model or run in seconds (0: none)."""
    memory_limit: float = 4.0
    """Memory limit of a model or run in GiB (0: none). On Linux."""

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit each other, and without Ray."""
        check_counts(self, processes=0, time_limit=0, memory_limit=0)
        if self.address is not None and self.engine != "ray":
            raise ValueError(f"--address: expected --engine ray, got --engine {self.engine}")
        if self.engine == "ray":
            require_library("ray", "for --engine ray")
        self.part()

    def part(self) -> tuple[int, int]:
        """Return number and count of the part to do, (0, 1) for all; raise ValueError for another text than I/N."""
        if self.shard is None:
            return 0, 1
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", self.shard)
        number, count = (int(found[1]), int(found[2])) if found else (0, 0)
        if number >= count:
            raise ValueError(f"--shard: expected I/N with I from 0 to N - 1, such as 3/64, got {self.shard}")
        return number, count


Engine = Annotated[EngineOptions, tyro.conf.arg(name="")]


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    """Render views of many models to a data set: shards in WebDataset format, or folders.

    MODEL is a mesh file, a folder with meshes, an archive of meshes (.zip, .tar, .tar.gz), or a list of paths (.txt,
    .csv, .parquet with a column path). The folder OUTPUT gets shards/*.tar with the views and cameras, index.parquet
    with a row for each sample, manifest.json, and failed.jsonl with the models that crashed, hung or could not be read.

    Example: neural-renderer dataset models -o views

    Example: neural-renderer dataset objaverse.csv -o views --cameras sphere --outputs rgba.webp depth.npy normal.png

    Example: neural-renderer dataset models -o views --engine ray --address auto

    Example: neural-renderer dataset models -o views --shard 3/64

    Ctrl-C keeps finished shards. The same command continues, and makes the same bytes as if nothing had happened.
    """

    models: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="MODEL", name="MODEL")]
    """Mesh files, folders, archives, or lists of paths."""
    output: Output
    """Folder for the data set; it is made if missing. For several machines, one that all of them see."""
    outputs: tuple[str, ...] = ("rgba.png",)
    """Files of each view, as output.suffix: rgba, rgb, alpha, depth, normal, position, uv, face_index or barycentric,
    with png, webp (rgba, rgb), jpg (rgb), exr (needs the extra "exr") or npy. position, uv and face_index need npy or
    exr. rgba has colours that are not multiplied by alpha. Depth and normals are as of render --save."""
    size: int | tuple[int, int] = 512
    """Side of the views, or height and width, in pixels (1 to 32768)."""
    cameras: str = "orbit"
    """orbit: around the y axis; sphere: in random directions, which depend on the model's name and --seed only; or a
    file of cameras, of any format of --camera of render."""
    views: int = 12
    """Views of each orbit, or of the sphere (at least 1)."""
    elevation: tuple[float, ...] = ()
    """Elevations in degrees: one for each orbit, by default 20; or the range of the sphere, by default -90 90."""
    azimuth: float = 150.0
    """First azimuth of an orbit in degrees, as of render."""
    distance: float | None = None
    """Distance of the cameras from the origin (above 0). By default the whole model is visible."""
    viewing_angle: float = 20.0
    """Half of the vertical field of view in degrees (above 0, below 90)."""
    normalize: bool = True
    """Move each model to the origin and scale its longest side to 2 units. The matrix is in the camera's file."""
    light: Literal["lamp", "sun", "none"] = "lamp"
    """Light. lamp: over the viewer's shoulder; sun: from one direction, the same in all views; none: colours as in the
    file."""
    environment: Path | None = None
    """Environment map (equirectangular: .hdr, .exr, .jpg, …) that lights the models instead."""
    shading: Literal["flat", "smooth", "phong", "pbr"] = "flat"
    """Shading, as of render."""
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Red, green and blue (0 to 1) behind rgb."""
    layers: int | None = None
    """Number of faces that are blended at each pixel (at least 1), for transparent materials."""
    depth_scale: float = DEPTH_SCALE
    """Steps of a 16-bit depth .png for one unit (above 0)."""
    seed: int = 0
    """Seed of random cameras."""
    sample: Literal["view", "model"] = "view"
    """A sample of the data set for each view, or for each model with all its views."""
    layout: Literal["shards", "folders"] = "shards"
    """Tars of samples, or a folder for each model."""
    models_per_shard: int | None = None
    """Models in a shard (at least 1). A killed worker loses its shard. By default 64, or fewer for short lists."""
    index: Literal["parquet", "csv"] = "parquet"
    """Format of the index. parquet needs the extra "cluster"."""
    allow_outside: AllowOutside = False
    engine: Engine = field(default_factory=EngineOptions)

    def validate(self) -> None:
        """Raise an error for options that are out of range, missing files and libraries, and an unwritable output."""
        self.engine.validate()
        check_counts(self, views=1, layers=1, models_per_shard=1, seed=0)
        check_between("viewing-angle", self.viewing_angle, 0, 90)
        check_between("depth-scale", self.depth_scale, 0, math.inf)
        if self.distance is not None:
            check_between("distance", self.distance, 0, math.inf)
        for height in self.elevation:
            check_between("elevation", height, -90.001, 90.001)
        if not math.isfinite(self.azimuth):
            raise ValueError(f"--azimuth: expected a finite number of degrees, got {self.azimuth}")
        if not all(0 <= value <= 1 for value in self.background):
            raise ValueError(f"--background: expected three numbers from 0 to 1, got {self.background}")
        for path in self.models:
            if not path.is_dir():
                existing(path, "a mesh, an archive, a list of them, or a folder")
            if path.suffix.lower() == ".parquet":
                require_library("pyarrow", f"for {path.name}")
        if self.cameras not in ("orbit", "sphere"):
            check_cameras(Path(self.cameras))
        check_inputs(self.environment)
        if self.index == "parquet":
            require_library("pyarrow", "for index.parquet")
        if any(output.endswith(".exr") for output in self.outputs):
            require_library("OpenEXR", f"to write {self.output}")
        check_folder("--output", self.output)


@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """Run fit, style, dream or finish many times: each row of a table is a run, each column an option.

    TABLE is a .csv whose header names options of the command, such as images, mesh, painting, steps or seed; empty
    cells are left out, and paths are relative to its folder. The column name names the results. The folder OUTPUT gets
    a folder for each row, reports.csv with the numbers of all reports, sheet.png with the meshes, and failed.jsonl.

    Example: neural-renderer batch fit scans.csv -o fitted

    Example: neural-renderer batch style pairs.csv -o styled --engine ray --address auto

    Ctrl-C keeps finished runs. The same command continues the others, from their last checkpoint.
    """

    command: Annotated[Literal["fit", "style", "dream", "finish"], tyro.conf.Positional]
    """Command to run."""
    table: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TABLE")]
    """Table of the runs, .csv."""
    output: Output
    """Folder for the results; it is made if missing. For several machines, one that all of them see."""
    engine: Engine = field(default_factory=lambda: EngineOptions(time_limit=0.0, memory_limit=8.0))

    def validate(self) -> None:
        """Raise an error for engines out of range, for a missing table, and for an output that cannot be written."""
        self.engine.validate()
        check_inputs(self.table)
        check_folder("--output", self.output)


def parse(arguments: list[str], prog: str) -> DatasetOptions | BatchOptions:
    """Parse the options of the command that ``prog`` ends with. A wrong --size is reported in one sentence."""
    kind: type[DatasetOptions] | type[BatchOptions] = DatasetOptions if prog.endswith("dataset") else BatchOptions
    if kind is DatasetOptions and (problem := problem_of_size(arguments)):
        raise UsageError(problem)
    return tyro.cli(kind, prog=prog, args=[word for word in arguments if word != "--debug"])
