"""Loading and saving of cameras in any format; images are not needed."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from ...io.atomic_write import write_file
from ..camera import Camera
from .entries import KINDS, entries_of, entry_camera, entry_size
from .keys import read_json, rows_of
from .lens_models import FISHEYES
from .opencv import has_opencv_lens, save_cameras, views_by_hand
from .posed import CameraFile
from .read import find_camera_file, read_camera_file


def load_cameras(path: Path, size: tuple[int, int] | None = None) -> tuple[Camera, list[tuple[int, int] | None]]:
    """Load the cameras of a file of any format, or with the matrices that `entries` describes, or in a folder.

    Returns also the height and width of each image in pixels, if the file has it; ``size`` replaces missing sizes.
    ValueError: The file is malformed, `Camera` does not have the lens, or a size is missing.
    """
    path = find_camera_file(path)
    rows = _entries(read_json(path)) if path.suffix.lower() == ".json" else None
    if rows is None:
        file = read_camera_file(path)
        given = [image.lens.size for image in file.images]
        sizes = [None if one is None else (round(one[0]), round(one[1])) for one in given]
        return _posed_cameras(file, sizes[0] or size), sizes
    entries = rows_of(path, rows)
    sizes = [entry_size(*entry) for entry in entries]
    if sizes[0] is None and size is None and any("K" in row and "rotation" not in row for _, row in entries):
        raise ValueError(f"{path}: expected the keys width and height, or a size of the image, got neither")
    return Camera.cat([entry_camera(where, row, sizes[0] or size) for where, row in entries]), sizes


def save(path: str | os.PathLike[str], camera: Camera, size: tuple[int, int] | None, names: Sequence[str]) -> None:
    """Write cameras as JSON; see `Camera.save`."""
    in_opencv = has_opencv_lens(camera) and not camera.mirrored
    if in_opencv and (camera.K is not None or size is not None):
        save_cameras(path, camera, names or [f"{number:03}.png" for number in range(len(camera))], size)
    else:
        write_file(path, json.dumps({"cameras": entries_of(camera)}, indent=1) + "\n")


def _entries(content: Any) -> Any:
    """Find the entries of a file with matrices; return None for other files."""
    if not isinstance(content, dict) or "views" in content or "frames" in content:
        return None
    if "cameras" in content:
        return content["cameras"]
    if isinstance(content.get("camera"), dict):  # report.json of fit
        content = content["camera"]
    elif views_by_hand(content) is not None:
        return None
    return [content] if any(kind in content for kind in KINDS) else None


def _posed_cameras(file: CameraFile, size: tuple[int, int] | None) -> Camera:
    """Make the cameras of a file of posed images, with the lenses of their images."""
    lenses = [image.lens for image in file.images]
    # A lens given by its field of view fits all image sizes of one aspect.
    full = size or ((1, 1) if all(lens.field is not None for lens in lenses) else None)
    if all(lens.model in FISHEYES for lens in lenses) and full is not None:
        K = torch.tensor([lens.intrinsics(full) for lens in lenses])
        bends = torch.tensor([[lens.values.get(name, 0.0) for name in ("k1", "k2", "k3", "k4")] for lens in lenses])
        return Camera.fisheye(K, *file.poses(), bends, orig_size=full)
    for image in file.images:
        if image.lens.needs_undistortion:
            raise ValueError(f"{image.where}: expected a pinhole, OPENCV or fisheye lens, got {image.lens.model}")
    return file.cameras(full)
