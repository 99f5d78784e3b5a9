"""Reading and writing of OpenEXR pictures, with the optional package OpenEXR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..atomic_write import replacing
from ..files import existing, import_library


def write_exr(path: Path, values: np.ndarray, name: str = "rgb") -> None:
    """Write an image [H, W] or [H, W, C] as float32, completely or not at all. ``name`` chooses the channels' names."""
    exr = open_exr(path)
    planes = values.astype(np.float32).reshape(*values.shape[:2], -1)
    channels = {key: np.ascontiguousarray(planes[..., i]) for i, key in enumerate(_channels(name, planes.shape[2]))}
    with replacing(path) as fresh, exr.File({"type": exr.scanlineimage}, channels) as image:
        image.write(str(fresh))


def read_exr(path: Path) -> np.ndarray:
    """Read the colours of an OpenEXR picture: [H, W, 3] float32 RGB, or grey three times; row 0 at the top."""
    exr = open_exr(existing(path), "read")
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


def open_exr(path: Path, purpose: str = "write") -> Any:
    """Import OpenEXR, to write or to read a file."""
    return import_library("OpenEXR", f"to {purpose} {path}")


def _channels(name: str, count: int) -> list[str]:
    known = {
        "rgb": ["R", "G", "B", "A"][:count] if count > 1 else ["Y"],
        "depth": ["Z"],
        "alpha": ["A"],
        "uv": ["uv.U", "uv.V"],
    }
    return known.get(name, [name] if count == 1 else [f"{name}.{axis}" for axis in "XYZ"[:count]])
