"""``scene_camera.json`` of the BOP benchmark of poses: K and the world-to-camera pose of each image.

``{"0": {"cam_K": [9 numbers], "cam_R_w2c": [9 numbers], "cam_t_w2c": [3 numbers], …}, …}``, by the number of the image;
matrices by rows. Lengths are in millimetres, like those of the benchmark's models. Files without ``cam_R_w2c`` are
those of scenes whose poses are relative to the camera: it is then at the origin. Images are ``rgb/000000.png`` or
``.jpg``, or in ``gray``.

Source: the description of the format in the BOP toolkit, docs/bop_datasets_format.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from ...io.files import short, warn
from .keys import check_rotation, matrix
from .lens_models import Lens
from .opencv import intrinsic_values
from .posed import CameraFile, PosedImage


def is_bop(content: Any) -> bool:
    """Test whether the content of a JSON file is that of ``scene_camera.json``."""
    rows = list(content.values()) if isinstance(content, dict) else []
    return any(isinstance(row, dict) and "cam_K" in row for row in rows)


def parse_bop(path: Path, content: dict[str, Any]) -> CameraFile:
    """Convert the content of a file; raises ValueError with the place if a key is missing or out of range."""
    kind = "gray" if not (path.parent / "rgb").is_dir() and (path.parent / "gray").is_dir() else "rgb"
    images, without = [], 0
    for name, row in content.items():
        where = f"{path}: image {short(name)}"
        if not isinstance(row, dict) or not (name.isascii() and name.isdigit() and len(name) < 10):
            raise ValueError(f"{where}: expected the number of an image and an object with keys, got {short(row)}")
        K = matrix(where, row, "cam_K", (9,), (3, 3)).reshape(3, 3)
        rotation, translation = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
        if "cam_R_w2c" in row or "cam_t_w2c" in row:
            rotation = matrix(where, row, "cam_R_w2c", (9,), (3, 3)).reshape(3, 3)
            translation = matrix(where, row, "cam_t_w2c", (3,), (3, 1)).reshape(3)
            check_rotation(where, "cam_R_w2c", rotation, row["cam_R_w2c"])
        else:
            without += 1
        lens = Lens("OPENCV", intrinsic_values(where, K))
        images.append(PosedImage(where, f"{kind}/{int(name):06}", rotation, translation, lens))
    if without:
        warn(f"{path}: {without} images have no cam_R_w2c; their cameras are at the origin, and look along +z")
    return CameraFile(path, images, (path.parent,))
