"""Options that several applications share, with their defaults. This module does not import torch."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...base.requirements import require_library
from .checks import check_folder


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Follow the run."""

    view: bool = False
    """Show the mesh in the browser while it changes, with curves, pause, stop and settings. Needs the extra
    "view"."""
    host: str = "127.0.0.1"
    """Name or address of this machine to listen on, for --view. Everybody who reaches another address sees the meshes
    and can stop the run."""
    port: int = 8080
    """First port to try, for --view; the next free one is taken. 0: any."""
    record: Path | None = None
    """HTML file that keeps the frames and that any browser opens, without Python."""
    record_limit: float = 32.0
    """Size of that file in MiB at most (at least 1)."""

    def validate(self) -> None:
        """Raise ModuleNotFoundError without viser, OSError if the record cannot be written."""
        if self.view:
            require_library("viser", "for the viewer")
        if self.record is not None:
            check_folder("--record", self.record.parent)


@dataclass(frozen=True, kw_only=True)
class MaskOptions:
    """Cut the object out of pictures without transparency or mask."""

    background: tuple[float, float, float] | None = None
    """Red, green and blue (0 to 1) of the background."""
    tolerance: float = 0.05
    """Largest difference from --background, in any channel (0 to 1), of a background pixel."""
    mask_below: float | None = None
    """Pixels whose brightest channel is below this (0 to 1) are background."""
    mask_open: int = 0
    """Remove parts of such masks that are thinner than this radius in pixels."""
    mask_close: tuple[int, int] = (0, 0)
    """Dilate such masks by the first radius in pixels, then erode them by the second, which fills gaps."""
    mask_fill: float = 0.0
    """Fill holes of such masks that are smaller than this share (0 to 1) of the object: shadows and highlights."""


SIZE = 256
"""Longer side in pixels to which larger images are scaled down."""
LEAST_SIDE = 16
"""Least side of images in pixels."""
DEPTH_SCALE = 1000.0
"""Steps of a 16-bit depth .png for one unit: with metres, millimetres."""
Steps = tyro.conf.arg(aliases=["--iterations"])
"""Annotation of the number of steps, which some commands once called iterations."""
Output = Annotated[Path, tyro.conf.arg(aliases=["-o", "--out"])]
Watch = Annotated[WatchOptions, tyro.conf.arg(name="")]
Mask = Annotated[MaskOptions, tyro.conf.arg(name="")]
Device = Annotated[
    Literal["auto", "cpu", "cuda"], tyro.conf.arg(help="Device to compute on; auto is CUDA if available.")
]
AllowOutside = Annotated[
    bool,
    tyro.conf.arg(help="Allow files to name images and materials outside of their folders. For trusted files only."),
]


def problem_of_size(arguments: Iterable[str]) -> str | None:
    """Return the error in the first value of --size, which has to be a number; None without one."""
    words = list(arguments)
    for place, word in enumerate(words):
        option, equals, value = word.partition("=")
        value = value if equals else "".join(words[place + 1 : place + 2])
        if option == "--size" and not re.fullmatch(r"[+-]?\d+", value):
            return f"--size: expected a side, or height and width such as --size 480 640, in pixels, got {value!r}"
    return None
