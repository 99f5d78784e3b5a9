"""Options of `neural-renderer demo`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..common.options import Device, Output


@dataclass(frozen=True)
class DemoOptions:
    """Render a turntable of a textured knot, fit a sphere to 24 silhouettes of a duck, and make a mesh of one picture.

    Needs no downloads.

    Example: neural-renderer demo -o out
    """

    output: Output = Path("out")
    """Folder for the results; it is made if missing."""
    frames: int = 48
    """Pictures of the turntable (at least 1)."""
    size: int = 320
    """Side of the pictures in pixels (at least 32)."""
    steps: int = 300
    """Steps of gradient descent for the shape (at least 1)."""
    views: int = 24
    """Silhouettes to fit (at least 1)."""
    view_size: int = 96
    """Side of the silhouettes in pixels (at least 16)."""
    seed: int = 0
    """Seed of the order of the views."""
    device: Device = "auto"
