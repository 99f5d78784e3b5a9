"""Sparse models of COLMAP: ``cameras``, ``images`` and ``points3D``, in binary or text files."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...io.files import read_bytes, read_text, short
from ..rotations import from_quaternion
from .keys import LARGEST
from .lens_models import MODELS, Lens
from .posed import CameraFile, PosedImage

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", ".")
"""Folders of models, relative to that of a data set: of COLMAP, and of nerfstudio."""
Camera = tuple[str, int, int, list[float]]  # model, width, height, parameters
Image = tuple[str, int, tuple[float, ...], tuple[float, ...]]  # name, camera, quaternion (w, x, y, z), translation
_NAMES = (
    [*MODELS][:11] + ["RAD_TAN_THIN_PRISM_FISHEYE"] + [*MODELS][11:] + ["EQUIRECTANGULAR"]
)  # by COLMAP's number of the model
_POINT_OF_IMAGE, _TRACK_ENTRY = 24, 8  # bytes


def model_file(folder: Path) -> Path | None:
    """Find a model in a folder or in its usual subfolders: the path of its images file, or None."""
    for inner in MODEL_FOLDERS:
        for suffix in (".bin", ".txt"):
            if all((folder / inner / (name + suffix)).is_file() for name in ("cameras", "images")):
                return folder / inner / ("images" + suffix)
    return None


def read_colmap(path: Path) -> CameraFile:
    """Read the model of ``images.bin`` or ``images.txt`` and the other files in its folder. Points are optional.

    OSError, ValueError: A file is missing or malformed, or a lens model is unknown.
    """
    cameras_path, points_path = (path.with_name(name + path.suffix) for name in ("cameras", "points3D"))
    if path.suffix.lower() == ".bin":
        cameras, rows = read_binary_cameras(cameras_path), read_binary_images(path)
        points = read_binary_points(points_path) if points_path.is_file() else None
    else:
        cameras, rows = read_text_cameras(cameras_path), read_text_images(path)
        points = read_text_points(points_path) if points_path.is_file() else None
    if not rows:
        raise ValueError(f"{path}: expected at least one image, got none")
    images = []
    for number, (name, camera, quaternion, translation) in rows.items():
        where = f"{path}: image {number}"
        if camera not in cameras:
            raise ValueError(f"{where}: expected a camera of {cameras_path.name}, got number {camera}")
        model, width, height, parameters = cameras[camera]
        if not all(abs(value) <= LARGEST for value in (*quaternion, *translation, *parameters)):
            raise ValueError(f"{where}: expected finite numbers, got others")
        if width <= 0 or height <= 0:
            raise ValueError(f"{cameras_path}: camera {camera}: expected a size above 0, got {width} x {height}")
        lens = Lens.of_model(f"{cameras_path}: camera {camera}", model, parameters, (height, width))
        images.append(PosedImage(where, name, rotation_of(where, quaternion), _vector(translation), lens))
    images.sort(key=lambda image: image.name)
    return CameraFile(path, images, _image_folders(path), points if points is not None and len(points) else None)


def rotation_of(where: str, quaternion: tuple[float, ...]) -> Tensor:
    """Convert a quaternion (w, x, y, z) to a rotation [3, 3]; raise ValueError if it is 0."""
    q = _vector(quaternion)
    if not float(q.norm()) > 1e-6:
        raise ValueError(f"{where}: expected a quaternion of length 1, got {short(quaternion)}")
    return from_quaternion(q)


def _vector(values: tuple[float, ...]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _image_folders(path: Path) -> tuple[Path, ...]:
    """List folders that may contain the images: next to the model, and next to the folders that COLMAP makes for it."""
    folder, folders = path.parent, [path.parent / "images", path.parent]
    while folder.name.isdigit() or folder.name in ("sparse", "colmap"):
        folder = folder.parent
        folders += [folder / "images", folder]
    return tuple(folders)


def read_text_cameras(path: Path) -> dict[int, Camera]:
    """Read ``cameras.txt``: cameras by number."""
    cameras = {}
    for where, words in _lines(path):
        if words:
            if len(words) < 5:
                raise _malformed(where, "number, model, width, height and parameters", words)
            numbers = _numbers(where, [words[0], *words[2:]])
            cameras[int(numbers[0])] = words[1], int(numbers[1]), int(numbers[2]), numbers[3:]
    return cameras


def read_text_images(path: Path) -> dict[int, Image]:
    """Read ``images.txt``: images by number. Each has two lines; the second lists its points, and may be empty."""
    images, lines = {}, list(_lines(path))
    while lines and not lines[0][1]:
        lines.pop(0)
    for where, words in lines[::2]:
        if not words:
            continue
        if len(words) < 10:
            raise _malformed(where, "number, quaternion, translation, camera and name", words)
        numbers = _numbers(where, words[:9])
        quaternion, translation = tuple(numbers[1:5]), tuple(numbers[5:8])
        images[int(numbers[0])] = " ".join(words[9:]), int(numbers[8]), quaternion, translation
    return images


def read_text_points(path: Path) -> Tensor:
    """Read the positions of ``points3D.txt``, [P, 3] float64."""
    positions = []
    for where, words in _lines(path):
        if words:
            if len(words) < 4:
                raise _malformed(where, "number and position", words)
            positions.append(_numbers(where, words[:4])[1:])
    return torch.tensor(positions, dtype=torch.float64).reshape(-1, 3)


def _lines(path: Path) -> list[tuple[str, list[str]]]:
    """List the lines that are no comments: place in the file, for messages, and words."""
    lines = enumerate(read_text(path).split("\n"), 1)
    return [(f"{path}: line {number}", line.split()) for number, line in lines if not line.startswith("#")]


def _numbers(where: str, words: list[str]) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise _malformed(where, "finite numbers", words)
    return numbers


def _malformed(where: str, expected: str, words: list[str]) -> ValueError:
    return ValueError(f"{where}: expected {expected}, got {short(' '.join(words))}")


class _Reader:
    """Sequential reader of a binary file; raises ValueError at the end of the file."""

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
            raise ValueError(f"{self._path}: expected a file of COLMAP, got one that ends early or has another format")
        return start

    def text(self) -> str:
        """Read text up to a zero byte."""
        end = self._data.find(b"\0", self._place)
        start = self.skip((end if end >= 0 else len(self._data)) + 1 - self._place)
        return self._data[start:end].decode("utf-8", errors="replace")


def read_binary_cameras(path: Path) -> dict[int, Camera]:
    """Read ``cameras.bin``: cameras by number."""
    file, cameras = _Reader(path), {}
    for _ in range(file.read("Q")[0]):
        number, kind, width, height = file.read("IiQQ")
        name = _NAMES[kind] if 0 <= kind < len(_NAMES) else f"number {kind}"
        if name not in MODELS:
            raise ValueError(f"{path}: camera {number}: expected a lens model out of {', '.join(MODELS)}, got {name}")
        cameras[number] = name, width, height, list(file.read(f"{len(MODELS[name].split())}d"))
    return cameras


def read_binary_images(path: Path) -> dict[int, Image]:
    """Read ``images.bin``: images by number."""
    file, images = _Reader(path), {}
    for _ in range(file.read("Q")[0]):
        number, *pose, camera = file.read("I7dI")
        images[number] = file.text(), camera, tuple(pose[:4]), tuple(pose[4:])
        file.skip(file.read("Q")[0] * _POINT_OF_IMAGE)
    return images


def read_binary_points(path: Path) -> Tensor:
    """Read the positions of ``points3D.bin``, [P, 3] float64."""
    file, positions = _Reader(path), []
    for _ in range(file.read("Q")[0]):
        positions.append(file.read("Q3d3BdQ"))
        file.skip(positions[-1][-1] * _TRACK_ENTRY)
    return torch.tensor([position[1:4] for position in positions], dtype=torch.float64).reshape(-1, 3)
