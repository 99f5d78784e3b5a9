"""Camera files of posed images, in the format of NeRF, with distances and angles, or with matrices.

``transforms.json`` is the format of NeRF. Intrinsics are given for all frames or for each: ``camera_angle_x`` (whole
horizontal field of view in radians), or ``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h`` in pixels; and optionally the
distortion ``k1``, ``k2``, ``p1``, ``p2``, ``k3``, or ``k1`` to ``k4`` with ``"camera_model": "OPENCV_FISHEYE"``. Each
of the ``frames`` has ``file_path``, ``transform_matrix`` (camera to world [4, 4]; the camera looks along −z, +y is up)
and optionally ``mask_path``.

``cameras.json`` is ``{"viewing_angle": 30, "views": [{"file": "000.png", "azimuth": 0, "elevation": 30, "distance":
2.7}, …]}``; ``cameras.csv`` has these columns. ``mask`` is optional. Angles are in degrees, as in
`get_points_from_angles`. ``viewing_angle`` is half the vertical field of view; the default is 30.

The module `camera_entries` describes files with matrices. Their entries may have ``file`` and ``mask``, too.
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ... import validate
from ...camera import Camera, get_points_from_angles
from ...io.files import read_text, reason, short
from ...io.named_files import is_file, is_outside, outside_error
from .camera_entries import KINDS, entry_camera, entry_size

_CAMERA_FILES = ("transforms.json", "transforms_train.json", "cameras.json", "cameras.csv")
_LARGEST = torch.finfo(torch.float32).max
_VIEWING_ANGLE = 30.0  # default of ``viewing_angle``
_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG")


@dataclass(frozen=True)
class Frame:
    """An entry of the camera file: an image, its mask, and its other keys.

    Attributes:
        where: Place in the camera file, for messages.
        image: Image file; the camera file itself if images are not needed.
        mask: Mask file, or None.
        numbers: All keys of the entry.
    """

    where: str
    image: Path
    mask: Path | None
    numbers: dict[str, Any]


def camera_file(path: Path) -> Path:
    """Find the camera file: ``path`` itself, or a file in the folder ``path``. Raises FileNotFoundError."""
    if path.is_file():
        return path
    if not path.is_dir():
        raise FileNotFoundError(f"{path}: expected a folder of images or a camera file, got nothing there")
    for name in _CAMERA_FILES:
        if (path / name).is_file():
            return path / name
    raise FileNotFoundError(f"{path}: expected one of {', '.join(_CAMERA_FILES)} in the folder, got none")


def load_cameras(path: Path, size: tuple[int, int] | None = None) -> tuple[Camera, tuple[int, int] | None]:
    """Load the cameras of a file, whether or not its images are there.

    Args:
        path: Camera file, or a folder that contains one.
        size: Height and width of the images in pixels, where the file does not say it.

    Returns:
        The cameras, on the CPU, and the height and width of the first image, if the file says it.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is malformed, or the lens needs a size and there is none.
    """
    path = camera_file(path)
    common, frames = read_frames(path, allow_outside=False, images=False)
    given = {**common, **frames[0].numbers}
    own = entry_size(frames[0].where, given)
    if own is None and "w" in given and "h" in given:
        pair = (_above_zero(frames[0].where, given, key) for key in ("h", "w"))
        own = tuple(round(side) for side in pair)  # type: ignore[assignment]
    if own is None and size is None and any("K" in frame.numbers or "fl_x" in given for frame in frames):
        keys = "w and h" if "frames" in common else "width and height"
        raise ValueError(f"{path}: expected the keys {keys}, or a size of the picture, got neither")
    full = own or size or (1, 1)
    return make_camera(path, common, frames, full), own


def read_frames(path: Path, allow_outside: bool, images: bool = True) -> tuple[dict[str, Any], list[Frame]]:
    """Parse a camera file: the keys for all images, and the entry of each image.

    Without ``images``, the entries need not name images that exist.
    """
    if path.suffix.lower() == ".csv":
        try:
            rows: list[Any] = list(csv.DictReader(read_text(path).splitlines(), skipinitialspace=True))
        except csv.Error as error:
            raise ValueError(f"{path}: expected CSV, got a file that cannot be parsed ({error})") from None
        common: dict[str, Any] = {"views": rows}
    else:
        try:
            common = json.loads(read_text(path))
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path}: expected JSON, got {reason(error)}") from None
        if isinstance(common, dict) and isinstance(common.get("camera"), dict):  # report.json of fit
            common = common["camera"]
        if isinstance(common, dict) and any(kind in common for kind in KINDS):
            common = {"cameras": [common]}
        kind = next((key for key in ("frames", "views", "cameras") if isinstance(common, dict) and key in common), None)
        if kind is None:
            raise ValueError(f'{path}: expected the key "frames" (NeRF), "views" or "cameras", got none of them')
        rows = common[kind]
    if not isinstance(rows, list) or not rows:
        raise ValueError(f"{path}: expected at least one image, got none")
    image_key, mask_key = ("file_path", "mask_path") if "frames" in common else ("file", "mask")
    frames = []
    for index, row in enumerate(rows):
        where = f"{path}: image {index}"
        if not isinstance(row, dict):
            raise ValueError(f"{where}: expected an object with keys, got {type(row).__name__}")
        image = _file(path, _key(where, row, image_key), allow_outside) if images else path
        mask = _file(path, row[mask_key], allow_outside) if images and row.get(mask_key) else None
        frames.append(Frame(where, image, mask, row))
    return common, frames


def _file(camera_file: Path, name: Any, allow_outside: bool) -> Path:
    """Find a file relative to the camera file; NeRF's data sets leave out suffixes."""
    name = str(name)
    if not allow_outside and is_outside(camera_file, name):
        raise outside_error(camera_file, name)
    for suffix in _SUFFIXES:
        found = camera_file.parent / (name + suffix)
        if is_file(found):
            return found
    raise FileNotFoundError(f"{camera_file}: expected a file {short(name)}, got nothing there")


def _key(where: str, row: dict[str, Any], key: str) -> Any:
    """Return the value of a key; raise ValueError if it is missing or empty."""
    if key in row and row[key] in (None, ""):
        raise ValueError(f'{where}: expected a value for the key "{key}", got none')
    if key not in row:
        raise ValueError(f'{where}: expected the key "{key}", got {(", ".join(map(str, row)) or "none")[:80]}')
    return row[key]


def _number(where: str, row: dict[str, Any], key: str, default: float | None = None) -> float:
    """Return the number of a key, or ``default`` if it is missing; raise ValueError if it is not finite."""
    value = row.get(key, default) if default is not None else _key(where, row, key)
    try:
        number = validate.number(key, float(value if value not in (None, "") else default))  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.inf
    if not abs(number) <= _LARGEST:
        raise ValueError(f"{where}: {key}: expected a finite number, got {short(value)}")
    return number


def _above_zero(where: str, row: dict[str, Any], key: str, default: float | None = None) -> float:
    """Return a number as `_number` does; raise ValueError if it is not > 0."""
    value = _number(where, row, key, default)
    if value <= 0:
        raise ValueError(f"{where}: {key}: expected a number above 0, got {value:g}")
    return value


def make_camera(path: Path, common: dict[str, Any], frames: list[Frame], size: tuple[int, int]) -> Camera:
    """Make the cameras of all images.

    Args:
        path: Camera file, for messages.
        common: Keys for all images, from `read_frames`.
        frames: Entries of the images, from `read_frames`.
        size: Height and width of the images in pixels.

    Raises:
        ValueError: A key is missing or out of range; the message names the place in the file.
    """
    if "cameras" in common:
        return Camera.cat([entry_camera(frame.where, frame.numbers, size) for frame in frames])
    return (_nerf_camera if "frames" in common else _angles_camera)(path, common, frames, size)


def _angles_camera(path: Path, common: dict[str, Any], frames: list[Frame], full: tuple[int, int]) -> Camera:
    """Make cameras from distances and angles (``cameras.json``, ``cameras.csv``)."""
    rows = [[_number(f.where, f.numbers, key) for key in ("distance", "elevation", "azimuth")] for f in frames]
    default = _number(str(path), common, "viewing_angle", _VIEWING_ANGLE)
    angles = [_number(f.where, f.numbers, "viewing_angle", default) for f in frames]
    for frame, (far, height, _), angle in zip(frames, rows, angles, strict=True):
        if abs(abs(height) - 90) < 1e-3:
            raise ValueError(f"{frame.where}: elevation: expected an angle other than ±90 degrees, got {height:g}")
        if far <= 0:
            raise ValueError(f"{frame.where}: distance: expected a number above 0, got {far:g}")
        if not 0 < angle < 90:
            raise ValueError(f"{frame.where}: viewing_angle: expected degrees between 0 and 90, got {angle:g}")
    distance, elevation, azimuth = torch.tensor(rows).unbind(1)
    return Camera.look_at(get_points_from_angles(distance, elevation, azimuth), viewing_angle=torch.tensor(angles))


def _nerf_camera(path: Path, common: dict[str, Any], frames: list[Frame], full: tuple[int, int]) -> Camera:
    """Make calibrated cameras (``transforms.json``)."""
    matrices, lenses, distortions, fisheye = [], [], [], []
    for frame in frames:
        given = {**{k: v for k, v in common.items() if k != "frames"}, **frame.numbers}
        matrices.append(_pose(frame))
        fisheye.append("FISHEYE" in str(given.get("camera_model", "")).upper())
        if not fisheye[-1] and _number(frame.where, given, "k4", 0.0):
            raise ValueError(f"{frame.where}: expected k1, k2, p1, p2 and k3, got k4 without a fisheye in camera_model")
        width, height = _above_zero(frame.where, given, "w", full[1]), _above_zero(frame.where, given, "h", full[0])
        if "fl_x" in given:
            across = _above_zero(frame.where, given, "fl_x")
        elif "camera_angle_x" in given:
            angle = _above_zero(frame.where, given, "camera_angle_x")
            if angle >= math.pi:
                raise ValueError(f"{frame.where}: camera_angle_x: expected radians below π, got {angle:g}")
            across = width / 2 / math.tan(angle / 2)
        else:
            raise ValueError(f'{path}: expected the key "camera_angle_x" or "fl_x", got neither')
        down = _above_zero(frame.where, given, "fl_y", across)
        cx, cy = _number(frame.where, given, "cx", width / 2), _number(frame.where, given, "cy", height / 2)
        sx, sy = full[1] / width, full[0] / height  # images may have been scaled since their calibration
        lenses.append([[across * sx, 0.0, cx * sx], [0.0, down * sy, cy * sy], [0.0, 0.0, 1.0]])
        keys = ("k1", "k2", "k3", "k4") if fisheye[-1] else ("k1", "k2", "p1", "p2", "k3")
        distortions.append([_number(frame.where, given, key, 0.0) for key in keys])
    if len(set(fisheye)) > 1:
        raise ValueError(f"{path}: expected all lenses to be fisheyes or none, got both")
    pose, distortion = torch.tensor(matrices), torch.tensor(distortions)
    # OpenGL's camera looks along −z with y up; OpenCV's looks along z with y down.
    rotation = torch.diag(torch.tensor([1.0, -1.0, -1.0])) @ pose[:, :3, :3].transpose(1, 2)
    translation = -torch.einsum("bij,bj->bi", rotation, pose[:, :3, 3])
    if fisheye[0]:
        return Camera.fisheye(torch.tensor(lenses), rotation, translation, distortion, orig_size=full)
    coefficients = distortion if bool(distortion.any()) else None
    return Camera.projection(torch.tensor(lenses), rotation, translation, coefficients, orig_size=full)


def _pose(frame: Frame) -> list[list[float]]:
    """Read the matrix from camera to world, [3, 4]."""
    value = _key(frame.where, frame.numbers, "transform_matrix")
    try:
        matrix = torch.tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        matrix = torch.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)) or not bool((matrix.abs() <= _LARGEST).all()):
        raise ValueError(f"{frame.where}: transform_matrix: expected 4 x 4 finite numbers, got {short(value)}")
    turn = matrix[:3, :3]
    if not torch.allclose(turn @ turn.t(), torch.eye(3, dtype=torch.float64), atol=1e-3) or torch.det(turn) < 0:
        raise ValueError(
            f"{frame.where}: transform_matrix: expected a rotation without scale or mirroring, got {short(value)}"
        )
    if len(matrix) == 4 and not torch.allclose(matrix[3], matrix.new_tensor([0, 0, 0, 1])):
        raise ValueError(f"{frame.where}: transform_matrix: expected the last row 0, 0, 0, 1, got {matrix[3].tolist()}")
    return matrix[:3].tolist()
