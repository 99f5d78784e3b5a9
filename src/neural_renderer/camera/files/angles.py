"""``cameras.json`` and ``cameras.csv`` with distances and angles.

``cameras.json`` is ``{"viewing_angle": 30, "views": [{"file": "000.png", "azimuth": 0, "elevation": 30, "distance":
2.7}, …]}``; ``cameras.csv`` has these columns. ``mask`` is optional. Angles are in degrees, as in
`get_points_from_angles`. ``viewing_angle`` is half the vertical field of view; the default is 30.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import torch

from ...io.files import read_text
from ..camera import Camera
from ..view import get_points_from_angles
from .keys import above_zero, mask_of, number, rows_of, value_of
from .lens_models import Lens
from .posed import CameraFile, PosedImage

_VIEWING_ANGLE = 30.0  # default of ``viewing_angle``


def read_csv(path: Path) -> CameraFile:
    """Read ``cameras.csv``."""
    try:
        rows = list(csv.DictReader(read_text(path).splitlines(), skipinitialspace=True))
    except csv.Error as error:
        raise ValueError(f"{path}: expected CSV, got a file that cannot be parsed ({error})") from None
    return parse_angles(path, {"views": rows})


def parse_angles(path: Path, content: dict[str, Any]) -> CameraFile:
    """Convert the content of ``cameras.json``."""
    default = number(str(path), content, "viewing_angle", _VIEWING_ANGLE)
    images, rows = [], rows_of(path, content["views"])
    for where, row in rows:
        name = str(value_of(where, row, "file"))
        far, height = above_zero(where, row, "distance"), number(where, row, "elevation")
        around, angle = number(where, row, "azimuth"), number(where, row, "viewing_angle", default)
        if abs(abs(height) - 90) < 1e-3:
            raise ValueError(f"{where}: elevation: expected an angle other than ±90 degrees, got {height:g}")
        if not 0 < angle < 90:
            raise ValueError(f"{where}: viewing_angle: expected degrees between 0 and 90, got {angle:g}")
        eye = torch.tensor(get_points_from_angles(far, height, around), dtype=torch.float64)
        try:
            axes = Camera.look_at(eye).rotation[0]
        except ValueError:  # only where the position rounds to the origin, which the camera looks at
            raise ValueError(f"{where}: distance: expected a camera away from the origin, got {far:g}") from None
        rotation = axes * axes.new_tensor([1.0, -1.0, 1.0])[:, None]
        lens = Lens("PINHOLE", {}, viewing_angle=angle)
        images.append(PosedImage(where, name, rotation, -rotation @ eye, lens, mask_of(row)))
    return CameraFile(path, images, (path.parent,), convention="distances and angles")
