"""Options of `neural-renderer view`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...base.requirements import existing
from ..common.checks import check_outputs
from ..common.options import AllowOutside, WatchOptions


@dataclass(frozen=True)
class ViewOptions:
    """Show meshes, results of a command, or a recording in the browser.

    A file is a mesh or a record (.html); several meshes stand side by side. A folder has the output of `fit`, `style`,
    `dream` or `reconstruct`, or meshes. The page shows inputs and results, pictures, curves, cameras with their
    photographs, and a slider through the frames of a record. Needs the extra "view".

    Example: neural-renderer view bunny.obj teapot.obj

    Example: neural-renderer view out

    Example: neural-renderer view bunny.obj --record bunny.html --no-browser

    On another machine: ssh -L 8080:127.0.0.1:8080 MACHINE, run it there, and open http://127.0.0.1:8080 here. Ctrl-C
    ends it.
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE|FOLDER")]
    """One or more mesh files, or one record or folder."""
    host: str = WatchOptions.host
    """Name or address of this machine to listen on. Everybody who reaches another address sees the meshes."""
    port: int = WatchOptions.port
    """First port to try; the next free one is taken. 0: any."""
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    """Axis that is up; by default +y, or what is up for the cameras."""
    record: Path | None = None
    """HTML file to write the scene to. Any browser opens it, without Python or a network."""
    browser: bool = True
    """Open a port for browsers. Without, only the record is written."""
    allow_outside: AllowOutside = False

    def validate(self) -> None:
        """Raise an error for options that do not fit each other, for missing files, and without viser."""
        if not self.paths:
            raise ValueError("paths: expected at least one file or folder, got none")
        if not self.browser and self.record is None:
            raise ValueError("--record: expected a file with --no-browser, got none")
        for path in self.paths:
            if not path.is_dir():
                existing(path, "a mesh, a record or a folder")
        WatchOptions(view=self.browser, record=self.record).validate()
        if self.record is not None:
            check_outputs([self.record], self.paths)
