"""Sparse models of COLMAP: ``cameras``, ``images`` and ``points3D``, in binary or text files."""

from __future__ import annotations

from pathlib import Path

import torch

from ...io.files import short
from .colmap_binary import read_binary_cameras, read_binary_images, read_binary_points
from .colmap_text import read_text_cameras, read_text_images, read_text_points
from .keys import LARGEST
from .lens import Lens
from .posed import CameraFile, PosedImage

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", ".")
"""Folders of models, relative to that of a data set: of COLMAP, and of nerfstudio."""


def model_file(folder: Path) -> Path | None:
    """Find a model in a folder or where programs put it: the path of its images file, or None."""
    for inner in MODEL_FOLDERS:
        for suffix in (".bin", ".txt"):
            if all((folder / inner / (name + suffix)).is_file() for name in ("cameras", "images")):
                return folder / inner / ("images" + suffix)
    return None


def read_colmap(path: Path) -> CameraFile:
    """Read the model of ``images.bin`` or ``images.txt``; the other files are beside it. Points are optional.

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


def rotation_of(where: str, quaternion: tuple[float, ...]) -> torch.Tensor:
    """Convert a quaternion (w, x, y, z) to a rotation [3, 3]; raise ValueError if it is 0."""
    q = _vector(quaternion)
    if not float(q.norm()) > 1e-6:
        raise ValueError(f"{where}: expected a quaternion of length 1, got {short(quaternion)}")
    w, x, y, z = (q / q.norm()).tolist()
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64)


def _vector(values: tuple[float, ...]) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _image_folders(path: Path) -> tuple[Path, ...]:
    """List folders that may contain the images: beside the model, and beside the folders that programs put it into."""
    folder, folders = path.parent, [path.parent / "images", path.parent]
    while folder.name.isdigit() or folder.name in ("sparse", "colmap"):
        folder = folder.parent
        folders += [folder / "images", folder]
    return tuple(folders)
