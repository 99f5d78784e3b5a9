"""Search for camera files, and reading of all formats."""

from __future__ import annotations

from pathlib import Path

from ...io.files import existing
from .angles import parse_angles, read_csv
from .bop import is_bop, parse_bop
from .colmap import model_file, read_colmap
from .idr import read_idr
from .keys import read_json
from .middlebury import read_middlebury
from .opencv import has_matrices, parse_opencv, views_by_hand
from .posed import CameraFile
from .transforms import parse_transforms

_NAMES = (
    "transforms.json",
    "transforms_train.json",
    "cameras.json",
    "cameras.csv",
    "cameras_sphere.npz",
    "cameras.npz",
    "scene_camera.json",
)
_EXPECTED = f"{', '.join(_NAMES)}, *_par.txt (Middlebury) or a model of COLMAP (sparse/0/images.bin or .txt)"


def find_camera_file(path: Path) -> Path:
    """Find a camera file: ``path`` itself, or one in the folder ``path``.

    FileNotFoundError: There is none. ValueError: There are several files of Middlebury.
    """
    if path.is_file():
        return path
    if not path.is_dir():
        raise FileNotFoundError(f"{path}: expected a folder of images or a camera file, got nothing there")
    for name in _NAMES:
        if (path / name).is_file():
            return path / name
    model = model_file(path)
    if model is not None:
        return model
    tables = sorted(path.glob("*_par.txt"))
    if len(tables) > 1:
        raise ValueError(f"{path}: expected one file *_par.txt, got {', '.join(table.name for table in tables)}"[:200])
    if not tables:
        raise FileNotFoundError(f"{path}: expected one of {_EXPECTED} in the folder, got none")
    return tables[0]


def read_camera_file(path: Path) -> CameraFile:
    """Read a camera file of any format; images are not opened. `CameraFile.cameras` makes a `Camera` of its lenses.

    OSError, ValueError: The file is missing or malformed; the message names the place.
    """
    existing(path)
    if path.suffix.lower() == ".csv":
        return read_csv(path)
    if path.suffix.lower() in (".bin", ".txt"):
        if path.stem.lower() in ("images", "cameras", "points3d"):
            return read_colmap(path.with_name("images" + path.suffix))
        return read_middlebury(path)
    if path.suffix.lower() == ".npz":
        return read_idr(path)
    if path.suffix.lower() not in (".json", ""):
        raise ValueError(
            f"{path}: expected a folder of images, or a camera file (.json, .csv, .npz, .bin or .txt), got neither"
        )
    content = read_json(path)
    if is_bop(content):
        return parse_bop(path, content)
    if isinstance(content, dict) and "frames" in content:
        return parse_transforms(path, content)
    views = views_by_hand(content)
    if views is None:
        raise ValueError(f'{path}: expected the key "frames" (NeRF) or "views", got neither')
    return parse_opencv(path, views) if has_matrices(views) else parse_angles(path, views)
