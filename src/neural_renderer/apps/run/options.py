"""Options of `neural-renderer run`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class RunOptions:
    """Run a Python program unchanged, without nvdiffrast, PyTorch3D and CUDA. If they are not installed, this package
    provides `nvdiffrast.torch` and a part of `pytorch3d`; on a machine without CUDA, the device "cuda" is the CPU. The
    same holds for what to_glb of TRELLIS.2 needs: cumesh and flex_gemm.ops.grid_sample.

    All arguments after the program belong to the program.

    Example: neural-renderer run fit.py --resolution 256
    """

    program: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PROGRAM", name="PROGRAM")]
    """Python file, or with -m the name of a module."""
    device: Annotated[
        Literal["auto", "cpu"], tyro.conf.arg(help='Device that "cuda" stands for; auto is CUDA if available.')
    ] = "auto"
    ours: bool = False
    """Use this package's modules even where those that they replace are installed."""
    module: Annotated[bool, tyro.conf.arg(aliases=["-m"])] = False
    """Run a module, as python -m does."""
    arguments: tyro.conf.Suppress[tuple[str, ...]] = ()

    def validate(self) -> None:
        """Raise FileNotFoundError if the program does not exist."""
        if not self.module and not Path(self.program).is_file():
            raise FileNotFoundError(2, "expected a Python file", self.program)


def parse(arguments: list[str], prog: str) -> RunOptions:
    """Parse the options up to the program. The words after it are the program's arguments."""
    place = 0
    while place < len(arguments) and arguments[place].startswith("-"):
        place += 2 if arguments[place] == "--device" else 1
    ours = [word for word in arguments[: place + 1] if word != "--debug"]
    return replace(tyro.cli(RunOptions, prog=prog, args=ours), arguments=tuple(arguments[place + 1 :]))
