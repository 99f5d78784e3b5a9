"""Images of numbers: .npy, OpenEXR, and PNG of 8 bits, or of 16 bits for depth."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from ...io.atomic_write import write_file
from ...io.image_formats.exr import write_exr
from ...io.image_formats.png import encode_png
from ...io.images import encode_image

VALUE_SUFFIXES = (".npy", ".exr")
_MOST = 65535  # largest number of 16 bits


def save_output(path: Path, values: np.ndarray, name: str, depth_scale: float = 1000.0) -> None:
    """Write an output of `render`, [H, W] or [H, W, C], in the format of the suffix; see `encode_output`."""
    if path.suffix.lower() == ".exr":
        write_exr(path, values, name)
    else:
        write_file(path, encode_output(path, values, name, depth_scale))


def encode_output(path: Path, values: np.ndarray, name: str, depth_scale: float = 1000.0, fast: bool = False) -> bytes:
    """Encode the output of `render` of a name, [H, W] or [H, W, C], for the file at ``path``.

    An .npy and an .exr keep the numbers; an .exr stores whole numbers as float32, exact up to 2²⁴. A .png holds
    (n + 1) / 2 of normals n, and depth · ``depth_scale`` in 16 bits, rounded, 0 where there is nothing; ``fast`` takes
    a quarter of the time for a file that is a fifth larger. ValueError: A depth is more than 65,535 steps.
    """
    suffix, file = path.suffix.lower(), io.BytesIO()
    if suffix == ".npy":
        np.save(file, values)
        return file.getvalue()
    if suffix == ".exr":
        with tempfile.TemporaryDirectory() as folder:  # OpenEXR writes to a path
            write_exr(Path(folder) / "image.exr", values, name)
            return (Path(folder) / "image.exr").read_bytes()
    if name == "depth":
        steps = np.multiply(values, depth_scale, dtype=np.float64)
        steps.round(out=steps)
        if steps.max(initial=0) > _MOST:
            most = _MOST / float(values.max())
            raise ValueError(
                f"depth_scale: expected at most {most:.4g}, so that 16 bits hold the depth, got {depth_scale:g}"
            )
        if fast:
            return encode_png(steps.astype(np.uint16))
        Image.fromarray(steps.astype(np.uint16)).save(file, "PNG")
        return file.getvalue()
    return encode_image(path, (values + 1) / 2 if name == "normal" else values, fast)
