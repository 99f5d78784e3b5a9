"""Images of numbers: .npy, OpenEXR, and PNG of 8 bits, or of 16 bits for depth."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from .atomic_write import write_file
from .image_formats.exr import write_exr
from .images import save_image

VALUE_SUFFIXES = (".npy", ".exr")
_MOST = 65535  # largest number of 16 bits


def save_values(path: Path, values: np.ndarray, name: str) -> None:
    """Write an image of numbers as .npy or .exr, unchanged.

    Args:
        path: Name that ends in .npy or .exr.
        values: [H, W] or [H, W, C], float32 or int32. An .exr stores whole numbers as float32, exact up to 2²⁴.
        name: Name of the image, for `write_exr`.

    Raises:
        ModuleNotFoundError: OpenEXR is not installed.
        OSError: The file cannot be written. An existing file stays as it was.
    """
    if path.suffix.lower() == ".npy":
        file = io.BytesIO()
        np.save(file, values)
        write_file(path, file.getvalue())
        return
    write_exr(path, values, name)


def save_depth(path: Path, depth: np.ndarray, scale: float) -> None:
    """Write depth [H, W] as a PNG of 16 bits: depth · scale, rounded, and 0 where there is nothing.

    Raises:
        ValueError: A depth is more than 65,535 steps.
        OSError: The file cannot be written. An existing file stays as it was.
    """
    steps = np.round(depth.astype(np.float64) * scale)
    if steps.max(initial=0) > _MOST:
        most = _MOST / float(depth.max())
        raise ValueError(f"depth_scale: expected at most {most:.4g}, so that 16 bits hold the depth, got {scale:g}")
    file = io.BytesIO()
    Image.fromarray(steps.astype(np.uint16)).save(file, "PNG")
    write_file(path, file.getvalue())


def save_output(path: Path, values: np.ndarray, name: str, depth_scale: float = 1000.0) -> None:
    """Write an output of `render`, [H, W] or [H, W, C], in the format of the suffix.

    A PNG holds (n + 1) / 2 of normals n, and `save_depth` of depth.
    """
    if path.suffix.lower() in VALUE_SUFFIXES:
        save_values(path, values, name)
    elif name == "depth":
        save_depth(path, values, depth_scale)
    else:
        save_image(path, (values + 1) / 2 if name == "normal" else values)
