"""Copies of photographs that are smoothed against noise, in which more features match."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from PIL import ImageFilter

from ....io.image_formats.pictures import open_picture
from .copies import IMAGES, MASKS, Photographs, write_copy


def smooth(photographs: Photographs, folder: Path, deviation: float, side: int) -> Photographs:
    """Write smoothed copies, and copies of their masks, to another folder.

    The standard deviation of the Gaussian is in pixels of copies that are reduced to a longer side.
    """
    for name in photographs.names:
        with open_picture(photographs.folder / IMAGES / name) as image:
            radius = deviation * max(1.0, max(image.size) / side)
            write_copy(folder / IMAGES / name, image.filter(ImageFilter.GaussianBlur(radius)))
    if (photographs.folder / MASKS).is_dir():
        shutil.copytree(photographs.folder / MASKS, folder / MASKS)
    return replace(photographs, folder=folder)
