"""``transforms.json``: the format of NeRF and Blender, of nerfstudio and of instant-ngp.

Intrinsics are given for all frames or for each: ``camera_angle_x`` (whole horizontal field of view in radians), or
``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h`` in pixels; and optionally ``camera_model`` and the distortion ``k1``,
``k2``, ``p1``, ``p2``, ``k3``, or ``is_fisheye`` of instant-ngp and ``k1`` to ``k4``. Each of the ``frames`` has
``file_path``, ``transform_matrix`` (camera to world [4, 4]; the camera looks along −z, +y is up) and optionally
``mask_path``.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import torch

from ...io.files import short
from .keys import above_zero, check_rotation, mask_of, matrix, number, rows_of, value_of
from .lens_models import Lens
from .posed import CameraFile, PosedImage

_PINHOLES = ("", "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL")
_OTHERS = ("ftheta_p0", "latlong", "equirectangular")  # keys of lenses of instant-ngp that are not read
_AXES = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))  # from OpenGL's camera axes to OpenCV's


def parse_transforms(path: Path, content: dict[str, Any]) -> CameraFile:
    """Convert the content of a file; raises ValueError with the place if a key is missing or out of range."""
    common = {key: value for key, value in content.items() if key != "frames"}
    images = []
    for where, row in rows_of(path, content["frames"]):
        name = str(value_of(where, row, "file_path"))
        pose = matrix(where, row, "transform_matrix", (4, 4), (3, 4))
        check_rotation(where, "transform_matrix", pose[:3, :3], row["transform_matrix"])
        if len(pose) == 4 and not torch.allclose(pose[3], pose.new_tensor([0, 0, 0, 1])):
            got = pose[3].tolist()
            raise ValueError(f"{where}: transform_matrix: expected the last row 0, 0, 0, 1, got {got}")
        rotation = _AXES @ pose[:3, :3].t()
        lens = _lens(path, where, {**common, **row})
        images.append(PosedImage(where, name, rotation, -rotation @ pose[:3, 3], lens, mask_of(row, "mask_path")))
    return CameraFile(path, images, (path.parent,), convention="camera-to-world, in OpenGL's axes")


def _lens(path: Path, where: str, row: dict[str, Any]) -> Lens:
    model = str(row.get("camera_model") or "").upper()
    for key in _OTHERS:
        if row.get(key):
            raise ValueError(f"{where}: {key}: expected a pinhole, OPENCV or fisheye lens, got a lens of instant-ngp's")
    if row.get("is_fisheye") not in (None, False, True):
        raise ValueError(f"{where}: is_fisheye: expected true or false, got {short(row['is_fisheye'])}")
    if row.get("is_fisheye") and model in _PINHOLES:
        model = "OPENCV_FISHEYE"
    if model in _PINHOLES:
        model = "OPENCV"
        if fourth := number(where, row, "k4", 0.0):
            raise ValueError(f"{where}: k4: expected 0 for a lens without camera_model OPENCV_FISHEYE, got {fourth:g}")
        values = {key: number(where, row, key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")}
    elif model == "OPENCV_FISHEYE":
        values = {key: number(where, row, key, 0.0) for key in ("k1", "k2", "k3", "k4")}
    else:
        raise ValueError(f"{where}: camera_model: expected OPENCV, PINHOLE or OPENCV_FISHEYE, got {short(model)}")
    for key in ("cx", "cy"):
        if row.get(key) not in (None, ""):
            values[key] = number(where, row, key)
    has_size = row.get("w") is not None or row.get("h") is not None
    size = (above_zero(where, row, "h"), above_zero(where, row, "w")) if has_size else None
    if "fl_x" in row:
        values["fx"] = above_zero(where, row, "fl_x")
        values["fy"] = above_zero(where, row, "fl_y", values["fx"])
        return Lens(model, values, size)
    if "camera_angle_x" not in row:
        raise ValueError(f'{path}: expected the key "camera_angle_x" or "fl_x", got neither')
    angle = above_zero(where, row, "camera_angle_x")
    if angle >= math.pi:
        raise ValueError(f"{where}: camera_angle_x: expected radians below π, got {angle:g}")
    if row.get("fl_y") not in (None, ""):
        values["fy"] = above_zero(where, row, "fl_y")
    return Lens(model, values, size, field=angle)
