"""PNG files that are encoded fast, or written strip by strip for images larger than the memory."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable

import numpy as np

from ..atomic_write import replacing

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOR_TYPES = {1: 0, 3: 2, 4: 6}  # by the number of channels
_UP = 2  # filter: the difference to the pixel above, which compresses better
_LEVEL, _FAST = 6, 2  # of the compression: as Pillow's, and fast
_COMMENT = b"Comment\0\0\0\0\0"  # a text in UTF-8, not compressed, of no language


def encode_png(pixels: np.ndarray, note: str = "") -> bytes:
    """Encode [H, W], [H, W, 3] or [H, W, 4] uint8, or [H, W] uint16, fast, with a note as the file's comment.

    One filter for all rows takes less time than Pillow, which tries five for each.
    """
    content = zlib.compress(_filtered(_rows(pixels), np.uint8(0)).data, _FAST)
    comment = _chunk(b"iTXt", _COMMENT + note.encode()) if note else b""
    return _start(pixels, *pixels.shape[:2]) + comment + _chunk(b"IDAT", content) + _chunk(b"IEND", b"")


def save_png_strips(path: str | os.PathLike[str], strips: Iterable[np.ndarray], height: int, width: int) -> None:
    """Write strips of rows, [rows, width] or [rows, width, 3 or 4] uint8, from the top, completely or not at all.

    ValueError: The strips differ in width or channels, or have another number of rows in all.
    """
    with replacing(path) as fresh, open(fresh, "wb") as file:
        packer, count, shape = zlib.compressobj(_LEVEL), 0, (width,)
        above: np.ndarray | np.uint8 = np.uint8(0)
        for strip in strips:
            if count == 0:
                shape = (width, *strip.shape[2:])
                file.write(_start(strip, height, width))
            if strip.shape[1:] != shape:
                raise ValueError(f"strips: expected [rows, {', '.join(map(str, shape))}], got {list(strip.shape)}")
            rows = _rows(strip)
            file.write(_chunk(b"IDAT", packer.compress(_filtered(rows, above).data)))
            count, above = count + len(rows), rows[-1]
        if count != height:
            raise ValueError(f"strips: expected {height} rows in all, got {count}")
        file.write(_chunk(b"IDAT", packer.flush()) + _chunk(b"IEND", b""))


def _rows(pixels: np.ndarray) -> np.ndarray:
    """Return the rows of an image as PNG stores them, [H, bytes] uint8: the high byte of 16 bits comes first."""
    stored = pixels if pixels.dtype == np.uint8 else pixels.astype(pixels.dtype.newbyteorder(">"))
    return np.ascontiguousarray(stored).view(np.uint8).reshape(len(pixels), -1)


def _filtered(rows: np.ndarray, above: np.ndarray | np.uint8) -> np.ndarray:
    """Subtract from each row the one before, from the first one ``above``; a byte before each names the filter."""
    filtered = np.empty((len(rows), 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = _UP
    np.subtract(rows[:1], above, out=filtered[:1, 1:])
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    return filtered


def _start(pixels: np.ndarray, height: int, width: int) -> bytes:
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    bits, kind = 8 * pixels.itemsize, _COLOR_TYPES[channels]
    return _SIGNATURE + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
