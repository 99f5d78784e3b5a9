"""Reading and writing of OpenEXR pictures, with the optional package OpenEXR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..atomic_write import replacing
from ..files import existing, import_library, reason, short
from .pictures import check_pixels

_STRIP = 1 << 20  # pixels of a channel in a strip that is decoded
_LINES = 256  # most lines of a block of the format
_MOST_BLOCK = 1 << 30  # bytes of all channels of a block
_LONGEST_HEADER = 1 << 22  # bytes
_MOST_NAMES = 4096  # of channels and attributes: OpenEXR compares each with all others
_LEAST_CHANNEL = 18  # bytes of a channel in the list
_IS_MULTIPART = 0x10  # bit in the sixth byte of a file


def write_exr(path: Path, values: np.ndarray, name: str = "rgb") -> None:
    """Write an image [H, W] or [H, W, C] as float32, completely or not at all. ``name`` chooses the channels' names."""
    exr = open_exr(path)
    planes = values.astype(np.float32).reshape(*values.shape[:2], -1)
    channels = {key: np.ascontiguousarray(planes[..., i]) for i, key in enumerate(_channels(name, planes.shape[2]))}
    with replacing(path) as fresh, exr.File({"type": exr.scanlineimage}, channels) as image:
        image.write(str(fresh))


def read_exr(path: Path) -> np.ndarray:
    """Read the colours of an OpenEXR picture: [H, W, 3] float32 RGB, or grey three times; row 0 at the top.

    Of its channels only these are decoded, some rows at a time.
    """
    exr = open_exr(existing(path), "read")
    import Imath  # comes with OpenEXR

    _check_header(path)
    try:
        with exr.File(str(path), separate_channels=True, header_only=True) as image:
            header = image.header()  # that of an `InputFile` ends the process if a name in it is no text
            low, high = (np.asarray(corner, dtype=np.int64).tolist() for corner in header["dataWindow"])
            channels = {channel.name: channel for channel in header["channels"]}
        file = exr.InputFile(str(path))
    except Exception as error:  # OpenEXR raises errors of several classes
        raise _damaged(path, error) from None
    width, height = high[0] - low[0] + 1, high[1] - low[1] + 1
    check_pixels(path, width, height)
    tiles = header.get("tiles")
    block = tiles.xSize * tiles.ySize if tiles else width * min(height, _LINES)
    if block * len(channels) * 4 > _MOST_BLOCK:  # it is decoded whole, with all channels
        got = f"{len(channels)} channels of {width} x {height}"
        raise ValueError(f"{path}: expected blocks of at most {_MOST_BLOCK >> 20} MiB, got {got}")
    names = "RGB" if all(name in channels for name in "RGB") else "Y"
    if names[0] not in channels:
        raise ValueError(f"{path}: expected the channels R, G and B, or Y, got {short(', '.join(channels))}")
    if any((channels[name].xSampling, channels[name].ySampling) != (1, 1) for name in names):
        raise ValueError(f"{path}: expected a colour in each pixel, got some for several")
    pixels, rows = np.empty((height, width, 3), np.float32), max(1, _STRIP // width)
    kind = Imath.PixelType(Imath.PixelType.FLOAT)
    try:
        for top in range(0, height, rows):
            end = min(top + rows, height)
            planes = file.channels(list(names), kind, low[1] + top, low[1] + end - 1)  # together: a block has all
            for channel in range(3):
                plane = np.frombuffer(planes[channel % len(names)], np.float32)
                pixels[top:end, :, channel] = plane.reshape(-1, width)
    except Exception as error:
        raise _damaged(path, error) from None
    return pixels


def _check_header(path: Path) -> None:
    """Raise ValueError if the headers of a file are too long, or have too many names, to be read by OpenEXR."""
    with path.open("rb") as file:
        data = file.read(_LONGEST_HEADER + 1)
    at, names, is_multipart = 8, 0, bool(data[5:6] and data[5] & _IS_MULTIPART)
    while at < len(data) and names <= _MOST_NAMES:
        if data[at] == 0:  # the end of a header
            if not is_multipart or data[at + 1 : at + 2] in (b"", b"\0"):
                return
            at += 1
        name = data.find(b"\0", at)
        kind = data.find(b"\0", name + 1)
        if name < 0 or kind < 0:
            return  # damaged, as OpenEXR will say
        size = int.from_bytes(data[kind + 1 : kind + 5], "little")
        names += 1 + (size // _LEAST_CHANNEL if data[name + 1 : kind] == b"chlist" else 0)
        at = kind + 5 + size
    if names > _MOST_NAMES or len(data) > _LONGEST_HEADER:
        most = f"{_MOST_NAMES:,} channels and attributes and {_LONGEST_HEADER >> 20} MiB"
        raise ValueError(f"{path}: expected a header of at most {most}, got a longer one")


def _damaged(path: Path, error: Exception) -> ValueError:
    return ValueError(f"{path}: expected a picture of OpenEXR, got one that cannot be read ({reason(error)})")


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
