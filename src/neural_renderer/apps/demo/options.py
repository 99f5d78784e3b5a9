"""Options of `neural-renderer demo`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ..common.checks import check_counts, check_folder
from ..common.options import Device, Output, Steps


@dataclass(frozen=True)
class DemoOptions:
    """Render a turntable of a textured knot, fit a sphere to 24 silhouettes of a duck, and reconstruct one picture.

    Needs no downloads.

    Example: neural-renderer demo -o out
    """

    output: Output = Path("out")
    """Folder for the results; it is made if missing."""
    frames: int = 48
    """Pictures of the turntable (at least 1)."""
    size: int = 320
    """Side of the pictures in pixels (at least 32)."""
    steps: Annotated[int, Steps] = 300
    """Steps of gradient descent for the shape (at least 1)."""
    views: int = 24
    """Silhouettes to fit (at least 1)."""
    view_size: int = 96
    """Side of the silhouettes in pixels (at least 16)."""
    seed: int = 0
    """Seed of the order of the views."""
    device: Device = "auto"

    def validate(self) -> None:
        """Raise an error for options that are out of range, and for an output that cannot be written."""
        check_counts(self, frames=1, size=32, steps=1, views=1, view_size=16)
        check_folder("--output", self.output)
