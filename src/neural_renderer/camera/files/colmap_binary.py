"""COLMAP's binary files, little-endian."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...io.files import read_bytes
from .colmap_text import Camera, Image
from .lens import MODELS

_NAMES = [*MODELS][:11] + ["RAD_TAN_THIN_PRISM_FISHEYE"] + [*MODELS][11:] + ["EQUIRECTANGULAR"]  # by number
_POINT_OF_IMAGE, _TRACK_ENTRY = 24, 8  # bytes


class _Reader:
    """Reads values one after the other; raises ValueError at the end of the file."""

    def __init__(self, path: Path) -> None:
        self._path, self._data, self._place = path, read_bytes(path), 0

    def read(self, form: str) -> tuple[Any, ...]:
        """Read the values of a format of `struct`."""
        values = struct.Struct("<" + form)
        start = self.skip(values.size)
        return values.unpack_from(self._data, start)

    def skip(self, count: int) -> int:
        """Skip bytes; return where they began."""
        start, self._place = self._place, self._place + count
        if self._place > len(self._data):
            raise ValueError(f"{self._path}: expected a file of COLMAP, got one that ends early or another file")
        return start

    def text(self) -> str:
        """Read text up to a zero byte."""
        end = self._data.find(b"\0", self._place)
        start = self.skip((end if end >= 0 else len(self._data)) + 1 - self._place)
        return self._data[start:end].decode("utf-8", errors="replace")


def read_binary_cameras(path: Path) -> dict[int, Camera]:
    """Read ``cameras.bin``: cameras by number. Raises ValueError if it is malformed or a lens model is unknown."""
    file, cameras = _Reader(path), {}
    for _ in range(file.read("Q")[0]):
        number, kind, width, height = file.read("IiQQ")
        name = _NAMES[kind] if 0 <= kind < len(_NAMES) else f"number {kind}"
        if name not in MODELS:
            raise ValueError(f"{path}: camera {number}: expected a lens model out of {', '.join(MODELS)}, got {name}")
        cameras[number] = name, width, height, list(file.read(f"{len(MODELS[name].split())}d"))
    return cameras


def read_binary_images(path: Path) -> dict[int, Image]:
    """Read ``images.bin``: images by number. Raises ValueError if it is malformed."""
    file, images = _Reader(path), {}
    for _ in range(file.read("Q")[0]):
        number, *pose, camera = file.read("I7dI")
        images[number] = file.text(), camera, tuple(pose[:4]), tuple(pose[4:])
        file.skip(file.read("Q")[0] * _POINT_OF_IMAGE)
    return images


def read_binary_points(path: Path) -> Tensor:
    """Read the places of ``points3D.bin``, [P, 3] float64. Raises ValueError if it is malformed."""
    file, places = _Reader(path), []
    for _ in range(file.read("Q")[0]):
        places.append(file.read("Q3d3BdQ"))
        file.skip(places[-1][-1] * _TRACK_ENTRY)
    return torch.tensor([place[1:4] for place in places], dtype=torch.float64).reshape(-1, 3)
