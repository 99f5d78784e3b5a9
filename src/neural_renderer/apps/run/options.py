"""Options of `neural-renderer run`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class RunOptions:
    """Run a Python program as it is: `nvdiffrast.torch` is this package's where nvdiffrast is not installed, and on a
    machine without CUDA what the program does on "cuda" happens on the CPU.

    All arguments after the program are its own.

    Example: neural-renderer run fit.py --resolution 256
    """

    program: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PROGRAM", name="PROGRAM")]
    """Python file, or with -m the name of a module."""
    device: Annotated[Literal["auto", "cpu"], tyro.conf.arg(help="Where CUDA happens; auto is CUDA if available.")] = (
        "auto"
    )
    ours: bool = False
    """Use this package's nvdiffrast.torch even where nvdiffrast is installed."""
    module: Annotated[bool, tyro.conf.arg(aliases=["-m"])] = False
    """Run a module, as python -m does."""
    arguments: tyro.conf.Suppress[tuple[str, ...]] = ()
