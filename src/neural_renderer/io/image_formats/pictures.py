"""Pictures that Pillow decodes: which formats, and how large."""

from __future__ import annotations

import os
from typing import IO

from PIL import Image

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "TGA", "DDS", "JPEG2000")
"""Formats that are read. Pillow has thirty more, which serve as ways in for files of strangers only."""
_PICTURES = 4  # of the largest size, in a model
_PER_BYTE = 64  # more pixels of a model for each byte of its pictures, as in JPEG's blocks of one shade


def open_picture(file: str | os.PathLike[str] | IO[bytes], *more: str) -> Image.Image:
    """Open a picture of one of the `FORMATS`, or of ``more``, whatever its name; its pixels are decoded later.

    Errors are Pillow's.
    """
    return Image.open(file, formats=(*FORMATS, *more))


def check_pixels(where: object, width: int, height: int, channels: int = 3) -> None:
    """Raise ValueError if a picture has no pixels, or more than `PIL.Image.MAX_IMAGE_PIXELS` of three channels."""
    limit = Image.MAX_IMAGE_PIXELS
    if width < 1 or height < 1:
        raise ValueError(f"{where}: expected a picture with pixels, got {width} x {height}")
    if limit is not None and width * height > (most := limit * 3 // channels):
        raise ValueError(
            f"{where}: expected a picture of at most {most:,} pixels, got {width} x {height}; "
            "a program may raise PIL.Image.MAX_IMAGE_PIXELS"
        )


class PictureSum:
    """Pixels of all pictures of a model: a few, or as many as the bytes of their files explain."""

    def __init__(self) -> None:
        self._pixels = self._bytes = 0

    def add(self, where: object, pixels: int, size: int) -> None:
        """Count a picture, whose file has ``size`` bytes; raise ValueError if there are too many pixels."""
        self._pixels, self._bytes = self._pixels + pixels, self._bytes + size
        limit = Image.MAX_IMAGE_PIXELS
        if limit is not None and self._pixels > (most := _PICTURES * limit + _PER_BYTE * self._bytes):
            raise ValueError(f"{where}: expected pictures of at most {most:,} pixels in all, got more in small files")
