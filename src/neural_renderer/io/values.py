"""Images of numbers: .npy, OpenEXR, and PNG of 8 bits, or of 16 bits for depth."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .atomic_write import replacing, write_file
from .files import existing, import_library
from .images import save_image

VALUE_SUFFIXES = (".npy", ".exr")
_MOST = 65535  # largest number of 16 bits


def save_values(path: Path, values: np.ndarray, name: str) -> None:
    """Write an image of numbers as .npy or .exr, unchanged.

    Args:
        path: Name that ends in .npy or .exr.
        values: [H, W] or [H, W, C], float32 or int32. An .exr stores whole numbers as float32, exact up to 2²⁴.
        name: Name of the image. In an .exr, channels are R, G, B for "rgb", Z for "depth", A for "alpha", and else
            ``name`` or ``name.X``, ``name.Y``, ``name.Z``.

    Raises:
        ModuleNotFoundError: OpenEXR is not installed.
        OSError: The file cannot be written. An existing file stays as it was.
    """
    if path.suffix.lower() == ".npy":
        file = io.BytesIO()
        np.save(file, values)
        write_file(path, file.getvalue())
        return
    exr = import_exr(path)
    planes = values.astype(np.float32).reshape(*values.shape[:2], -1)
    channels = {key: np.ascontiguousarray(planes[..., i]) for i, key in enumerate(_channels(name, planes.shape[2]))}
    with replacing(path) as fresh, exr.File({"type": exr.scanlineimage}, channels) as image:
        image.write(str(fresh))


def read_exr(path: Path) -> np.ndarray:
    """Read the colours of an OpenEXR picture: [H, W, 3] float32 RGB, or grey three times; row 0 at the top.

    Raises:
        FileNotFoundError: The file does not exist.
        ModuleNotFoundError: OpenEXR is not installed.
        ValueError: The file is damaged, has no such channels, or more than ``PIL.Image.MAX_IMAGE_PIXELS`` pixels.
    """
    exr = import_exr(existing(path), "read")
    limit = Image.MAX_IMAGE_PIXELS
    try:
        with exr.File(str(path), separate_channels=True, header_only=True) as image:
            low, high = (np.asarray(corner, dtype=np.int64) for corner in image.header()["dataWindow"])
        if limit is None or (high - low + 1).prod() <= limit:
            with exr.File(str(path), separate_channels=True) as image:
                channels = {name: channel.pixels for name, channel in image.channels().items()}
    except Exception as error:  # OpenEXR raises errors of several classes
        raise ValueError(f"{path}: expected a picture of OpenEXR, got one that cannot be read ({error})") from None
    if limit is not None and (high - low + 1).prod() > limit:
        raise ValueError(f"{path}: expected a picture of at most {limit:,} pixels")
    names = "RGB" if all(name in channels for name in "RGB") else "YYY"
    if names[0] not in channels:
        raise ValueError(f"{path}: expected the channels R, G and B, or Y, got {', '.join(channels)}")
    return np.stack([channels[name] for name in names], -1).astype(np.float32)


def import_exr(path: Path, purpose: str = "write") -> Any:
    """Import OpenEXR, to write or to read a file."""
    return import_library("OpenEXR", f"to {purpose} {path}")


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


def _channels(name: str, count: int) -> list[str]:
    known = {"rgb": ["R", "G", "B"], "depth": ["Z"], "alpha": ["A"], "uv": ["uv.U", "uv.V"]}
    return known.get(name, [name] if count == 1 else [f"{name}.{axis}" for axis in "XYZ"[:count]])
