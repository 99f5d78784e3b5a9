"""Radiance's pictures (.hdr, .pic): RGB with a shared exponent, for linear light of any strength.

The format is that of Ward, "Real Pixels" (Graphics Gems II, 1991): a header of lines that ends with an empty one, the
size, then rows of pixels, of four bytes each, plain or run-length encoded in one of two ways.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator

import numpy as np

from ..files import existing, read_bytes
from .pictures import check_pixels

_SIZE = re.compile(rb"([+-])Y (\d{1,9}) ([+-])X (\d{1,9})$")
_STRIP = 1 << 20  # pixels converted at once
_LONGEST = 40  # bytes of a size
_CODED = range(8, 32768)  # widths of rows that may hold the runs of each channel one after the other


def read_radiance(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a Radiance picture in the format "32-bit_rle_rgbe": [H, W, 3] float32, linear RGB; row 0 at the top."""
    data = read_bytes(existing(path))
    begin = data.find(b"\n\n") % (len(data) + 1)
    lines = data[:begin].split(b"\n")
    if not lines[0].startswith(b"#?"):
        raise ValueError(f"{path}: expected a picture of Radiance, got a file of another format")
    values = [line.partition(b"=")[::2] for line in lines[1:]]
    if any(name == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe" for name, value in values):
        raise ValueError(f"{path}: expected RGB with an exponent (32-bit_rle_rgbe), got another format")
    end = data.find(b"\n", begin + 2) % (len(data) + 1)
    size = _SIZE.match(data[begin + 2 : end][:_LONGEST].strip())
    if size is None:
        got = data[begin + 2 : end][:_LONGEST]
        raise ValueError(f"{path}: expected a size such as -Y 512 +X 1024, got {got!r}")
    height, width = int(size[2]), int(size[4])
    check_pixels(path, width, height)
    pixels = np.empty((height, width, 3), np.float32)
    filled = pixels[:: -1 if size[1] == b"+" else 1, :: -1 if size[3] == b"-" else 1]
    try:
        exposure = np.prod([float(value) for name, value in values if name == b"EXPOSURE"], initial=1.0)
        if not 0 < exposure < np.inf:
            raise ValueError
        row = 0
        for part in _rows(data, end + 1, height, width):
            for left in range(0, width, _STRIP):
                columns = slice(left, left + _STRIP)
                filled[row : row + len(part), columns] = _radiance(part[:, columns]) / exposure
            row += len(part)
    except (IndexError, ValueError):
        raise ValueError(f"{path}: expected a picture of Radiance, got a damaged one") from None
    return pixels


def _radiance(coded: np.ndarray) -> np.ndarray:
    """Decode pixels [H, W, 4] uint8; an exponent of 0 means black."""
    exponent = coded[..., 3:].astype(np.float64)
    return coded[..., :3] * np.where(exponent > 0, np.exp2(exponent - 136), 0)


def radiance_bytes(pixels: np.ndarray) -> bytes:
    """Encode linear RGB [H, W, 3], ≥ 0 and below 2¹²⁷, without runs; errors are up to 1/256 of the largest channel."""
    _, exponent = np.frexp(pixels.max(-1, keepdims=True))
    exponent = exponent.clip(-127, 127)
    coded = np.concatenate((np.round(np.ldexp(pixels, 8 - exponent)).clip(0, 255), exponent + 128), -1)
    coded[(pixels < 1e-38).all(-1)] = 0
    size = f"-Y {pixels.shape[0]} +X {pixels.shape[1]}"
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}\n".encode() + coded.astype(np.uint8).tobytes()


def _rows(data: bytes, at: int, height: int, width: int) -> Iterator[np.ndarray]:
    """Decode some rows at a time, [h, W, 4] uint8; raise IndexError or ValueError if they end too early."""
    most, rows = max(1, _STRIP // width), []
    for number in range(1, height + 1):
        if width in _CODED and data[at : at + 2] == b"\2\2" and data[at + 2] << 8 | data[at + 3] == width:
            row, at = _row_of_channels(data, at + 4, width)
        else:
            row, at = _row_of_pixels(data, at, width)
        rows.append(row)
        if len(rows) == most or number == height:
            yield np.frombuffer(b"".join(rows), np.uint8).reshape(-1, width, 4)
            rows = []


def _row_of_channels(data: bytes, at: int, width: int) -> tuple[bytes, int]:
    """Decode a row whose four channels are coded one after the other; return it, and where the next one begins."""
    row = bytearray()
    while len(row) < 4 * width:
        count = data[at]
        if count > 128:  # a run of one byte
            row += data[at + 1 : at + 2] * (count - 128)
            at += 2
        else:
            row += data[at + 1 : at + 1 + count]
            at += 1 + count
        if not count:
            raise ValueError
    return np.frombuffer(bytes(row), np.uint8).reshape(4, width).T.tobytes(), at


def _row_of_pixels(data: bytes, at: int, width: int) -> tuple[bytes, int]:
    """Decode a row of pixels; (1, 1, 1, n) repeats the one before, n · 256ᵏ times after k such pixels."""
    row, shift = bytearray(), 0
    while len(row) < 4 * width:
        pixel = data[at : at + 4]
        at += 4
        if pixel[:3] == b"\1\1\1" and row:
            row += bytes(row[-4:]) * min(pixel[3] << shift, width)
            shift += 8
        elif len(pixel) == 4:
            row, shift = row + pixel, 0
        else:
            raise IndexError
    if len(row) != 4 * width:
        raise ValueError
    return bytes(row), at
