"""``cameras.json`` with K, R and t of each image in OpenCV's conventions; easily written by hand.

``{"K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], "views": [{"file": "000.png", "R": [[…], […], […]], "t": [x, y, z]},
…]}`` has one K for all images, or one in each view. The pixel at X is K · (R · X + t): R turns from the world to the
camera, x right, y down, z forward. ``dist`` (k1, k2, p1, p2, k3), ``width`` and ``height`` of the calibrated image, and
``mask`` are optional. A list of views, or an object with a view for each name of an image, will do, too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...io.atomic_write import write_file
from ..camera import Camera, world_origin
from ..distortion import BROWN_CONRADY, lens_model
from .keys import above_zero, check_rotation, mask_of, matrix, rows_of, value_of
from .lens_models import Lens
from .posed import CameraFile, PosedImage


def views_by_hand(content: Any) -> dict[str, Any] | None:
    """Convert any of the three forms of the file to the first; return None for other content."""
    if isinstance(content, list):
        return {"views": content}
    if not isinstance(content, dict) or "frames" in content:
        return None
    if "views" in content:
        return content
    named = {name: row for name, row in content.items() if isinstance(row, dict) and ("R" in row or "t" in row)}
    if not named:
        return None
    common = {name: value for name, value in content.items() if name not in named}
    return {**common, "views": [{"file": name, **row} for name, row in named.items()]}


def has_matrices(content: dict[str, Any]) -> bool:
    """Return whether views have matrices, rather than distances and angles."""
    views = content["views"]
    return isinstance(views, list) and any(isinstance(row, dict) and not row.keys().isdisjoint("KRt") for row in views)


def parse_opencv(path: Path, content: dict[str, Any]) -> CameraFile:
    """Convert the content of a file; raises ValueError with the place if a key is missing or out of range."""
    common = {key: value for key, value in content.items() if key != "views"}
    images = []
    for where, row in rows_of(path, content["views"]):
        name, given = str(value_of(where, row, "file")), {**common, **row}
        K = matrix(where, given, "K", (3, 3))
        rotation, translation = matrix(where, given, "R", (3, 3)), matrix(where, given, "t", (3,), (3, 1), (1, 3))
        check_rotation(where, "R", rotation, given["R"])
        size = None
        if given.get("width") is not None and given.get("height") is not None:
            size = above_zero(where, given, "height"), above_zero(where, given, "width")
        lens = Lens("OPENCV", {**intrinsic_values(where, K), **_distortion(where, given)}, size)
        images.append(PosedImage(where, name, rotation, translation.reshape(3), lens, mask_of(row)))
    return CameraFile(path, images, (path.parent,))


def intrinsic_values(where: str, K: Any) -> dict[str, float]:
    """Return the values of an intrinsic matrix [3, 3] by name; raise ValueError for other matrices."""
    (fx, skew, cx), (zero, fy, cy), last = K.tolist()
    if not (fx > 0 and fy > 0):
        raise ValueError(f"{where}: K: expected focal lengths above 0, got {fx:g} and {fy:g}")
    if abs(zero) > 1e-6 * fy or max(abs(last[0]), abs(last[1]), abs(last[2] - 1)) > 1e-6:
        raise ValueError(f"{where}: K: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}")
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": skew}


def _distortion(where: str, row: dict[str, Any]) -> dict[str, float]:
    if row.get("dist") in (None, []):
        return {}
    values = matrix(where, row, "dist", (5,), (4,)).tolist()
    return dict(zip(("k1", "k2", "p1", "p2", "k3"), values, strict=False))


def save_cameras(
    path: str | os.PathLike[str],
    cameras: Camera | Sequence[Camera],
    names: Sequence[str],
    size: tuple[int, int] | None = None,
) -> None:
    """Write cameras with perspective as K, R and t in the conventions of OpenCV, with an image name for each.

    ``cameras`` may be several batches with images of different sizes. ``size``, height and width in pixels, is for
    cameras without K. ValueError: A camera is orthographic or a fisheye.
    """
    rows = [row for each in cameras for row in camera_rows(each, size)]
    if len(names) != len(rows):
        raise ValueError(f"names: expected {len(rows)} names, got {len(names)}")
    views = [{"file": name, **row} for name, row in zip(names, rows, strict=True)]
    write_file(path, json.dumps({"views": views}, indent=1) + "\n")


def has_opencv_lens(camera: Camera) -> bool:
    """Check whether cameras have perspective and at most OpenCV's five coefficients of distortion."""
    return camera.perspective and lens_model(camera.dist_coeffs) in (None, BROWN_CONRADY)


def camera_rows(camera: Camera, size: tuple[int, int] | None = None) -> list[dict[str, Any]]:
    """Describe each camera of a batch as in a file; arguments and errors as `save_cameras`."""
    if not has_opencv_lens(camera):
        raise ValueError("camera: expected perspective without a fisheye lens, got another")
    camera = camera if camera.K is not None else camera.with_K(size)
    K, (height, width) = camera.K, camera.orig_size  # type: ignore[misc]
    rotation, translation = camera.rotation, world_origin(camera)
    rows: list[dict[str, Any]] = []
    for number in range(len(camera)):
        row: dict[str, Any] = {"width": round(width), "height": round(height), "K": K[number].tolist()}  # type: ignore[index]
        if camera.dist_coeffs is not None:
            row["dist"] = camera.dist_coeffs[number].tolist()
        rows.append({**row, "R": rotation[number].tolist(), "t": translation[number].tolist()})
    return rows
