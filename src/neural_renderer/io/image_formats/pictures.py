"""Pictures that Pillow decodes: which formats, and how large."""

from __future__ import annotations

import os
import re
from typing import IO

from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "TGA", "DDS", "JPEG2000")
"""Formats that are read. Pillow has thirty more, which serve as ways in for files of strangers only."""
_PICTURES = 4  # of the largest size, in a model
_PER_BYTE = 64  # more pixels of a model for each byte of its pictures, as in JPEG's blocks of one shade
_MOST_SCANS = 100  # of a progressive JPEG; encoders write about ten
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]", re.DOTALL)  # of JPEG, with a segment after it
_SCAN, _END = 0xDA, 0xD9  # markers of ISO/IEC 10918-1, table B.1


def open_picture(file: str | os.PathLike[str] | IO[bytes], *more: str) -> Image.Image:
    """Open a picture of one of the `FORMATS`, or of ``more``, whatever its name; its pixels are decoded later.

    Errors are Pillow's, and OSError if a JPEG has so many scans that it would be decoded for hours.
    """
    picture = Image.open(file, formats=(*FORMATS, *more))
    content = picture.fp if isinstance(picture, JpegImageFile) and picture.info.get("progressive") else None
    if content is not None and _scans(content) > _MOST_SCANS:
        picture.close()
        raise OSError(f"it has more than {_MOST_SCANS} scans")
    return picture


def _scans(content: IO[bytes]) -> int:
    """Count the scans of a JPEG, each of which changes all pixels, without those of previews in it and after it."""
    before = content.tell()
    content.seek(0)
    data, at, scans = content.read(), 2, 0
    content.seek(before)
    while (marker := _MARKER.search(data, at)) and marker[0][1] != _END:
        at = marker.end() + int.from_bytes(data[marker.end() : marker.end() + 2], "big")
        scans += marker[0][1] == _SCAN
    return scans


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
