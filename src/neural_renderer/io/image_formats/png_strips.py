"""PNG files that are written strip by strip, for images larger than the memory."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable

import numpy as np

from ..atomic_write import replacing

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOR_TYPES = {1: 0, 3: 2, 4: 6}  # by the number of channels
_SUB = 1  # filter: the difference to the pixel on the left, which compresses better
_LEVEL = 6  # of the compression, as Pillow's


def save_png_strips(path: str | os.PathLike[str], strips: Iterable[np.ndarray], height: int, width: int) -> None:
    """Write strips of rows, [rows, width] or [rows, width, 3 or 4] uint8, from the top, completely or not at all."""
    with replacing(path) as fresh, open(fresh, "wb") as file:
        packer, rows, channels = zlib.compressobj(_LEVEL), 0, 0
        for strip in strips:
            pixels = strip.reshape(*strip.shape[:2], -1)
            if rows == 0:
                channels = pixels.shape[2]
                header = struct.pack(">IIBBBBB", width, height, 8, _COLOR_TYPES[channels], 0, 0, 0)
                file.write(_SIGNATURE + _chunk(b"IHDR", header))
            if pixels.shape[1:] != (width, channels):
                raise ValueError(f"strips: expected [rows, {width}, {channels}], got {list(pixels.shape)}")
            rows += len(pixels)
            filtered = np.empty((len(pixels), 1 + width * channels), np.uint8)
            filtered[:, 0] = _SUB
            filtered[:, 1 : 1 + channels] = pixels[:, 0]
            filtered[:, 1 + channels :] = (pixels[:, 1:] - pixels[:, :-1]).reshape(len(pixels), -1)
            file.write(_chunk(b"IDAT", packer.compress(filtered.data)))
        if rows != height:
            raise ValueError(f"strips: expected {height} rows in all, got {rows}")
        file.write(_chunk(b"IDAT", packer.flush()) + _chunk(b"IEND", b""))


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
