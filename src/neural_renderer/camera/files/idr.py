"""``cameras.npz`` of IDR, and ``cameras_sphere.npz`` of NeuS: a projection matrix of each image.

``world_mat_0``, [4, 4] or [3, 4], projects points of the world to pixels of image 0, and ``scale_mat_0``, [4, 4], moves
the unit ball around the object into the world. Like the programs, the reader gives cameras in the space of that ball,
with the projection world_mat · scale_mat. Images are those of the folder ``image`` in the order of their names, and
masks those of ``mask``.

Sources: Yariv et al., Multiview Neural Surface Reconstruction by Disentangling Geometry and Appearance, 2020; Wang et
al., NeuS, 2021. The product K · R of the projection is split as in Hartley and Zisserman, Multiple View Geometry, A4.1.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ...io.files import short
from ..matrices import decomposed
from .keys import LARGEST
from .lens_models import Lens
from .opencv import intrinsic_values
from .posed import CameraFile, PosedImage

_MOST_BYTES = 1 << 16  # of a matrix in the file
_KEY = re.compile(r"world_mat_(\d{1,9})")
_PICTURES = (".png", ".jpg", ".jpeg")


def read_idr(path: Path) -> CameraFile:
    """Read a file; raises ValueError with the key if it is malformed."""
    try:
        archive = zipfile.ZipFile(path)
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        raise ValueError(f"{path}: expected matrices saved by NumPy (npz), got a damaged file or another") from None
    with archive:
        return _read(path, archive)


def _read(path: Path, archive: zipfile.ZipFile) -> CameraFile:
    sizes = {info.filename.removesuffix(".npy"): info.file_size for info in archive.infolist()}
    numbers = sorted(int(found[1]) for name in sizes if (found := _KEY.fullmatch(name)))
    if not numbers:
        raise ValueError(f"{path}: expected the key world_mat_0, got {short(', '.join(sizes) or 'none')}")
    names, masks = (_pictures(path.parent / folder) for folder in ("image", "mask"))
    images = []
    for number in numbers:
        where = f"{path}: world_mat_{number}"
        matrix = _matrix(archive, f"world_mat_{number}", sizes)
        scale = f"scale_mat_{number}"
        if scale in sizes:
            matrix = matrix @ _matrix(archive, scale, sizes)
        determinant = torch.linalg.det(matrix[:3, :3])
        if not abs(determinant) > 1e-12 * float(matrix[:3, :3].norm()) ** 3:
            raise ValueError(f"{where}: expected a projection with perspective, got {short(matrix.tolist())}")
        K, rotation, translation = (part[0] for part in decomposed((matrix[:3] * determinant.sign())[None]))
        name = names[number] if number < len(names) else f"image/{number:06}"
        mask = masks[number] if number < len(masks) else None
        images.append(PosedImage(where, name, rotation, translation, Lens("OPENCV", intrinsic_values(where, K)), mask))
    return CameraFile(path, images, (path.parent,), convention="projections of the object's unit ball")


def _matrix(archive: zipfile.ZipFile, name: str, sizes: dict[str, int]) -> Tensor:
    """Read a matrix [4, 4] of the file; a last row 0, 0, 0, 1 is added to one [3, 4]."""
    found: np.ndarray = np.zeros(0)
    if sizes[name] <= _MOST_BYTES:
        try:
            with archive.open(f"{name}.npy") as file:
                found = np.lib.format.read_array(file, allow_pickle=False).astype(np.float64, casting="same_kind")
        except Exception:  # numpy and zipfile raise errors of many classes for damaged files
            found = np.zeros(0)
    if found.shape not in ((4, 4), (3, 4)) or not (np.abs(found) <= LARGEST).all():
        raise ValueError(f"{archive.filename}: {name}: expected 4 x 4 finite numbers, got {list(found.shape)}")
    return torch.from_numpy(np.concatenate((found, np.eye(4)[len(found) :])))


def _pictures(folder: Path) -> list[str]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return [f"{folder.name}/{file.name}" for file in files if file.suffix.lower() in _PICTURES]
