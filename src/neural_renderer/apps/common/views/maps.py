"""Normal and depth maps beside the images of a camera file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....base import validate
from ....camera import Camera
from ....camera.files import PosedImage
from ....io.files import existing, reason
from ....io.image_formats.pictures import check_pixels, open_picture
from ....io.images import load_image, reading_picture
from ..options import DEPTH_SCALE
from .undistortion import undistort
from .views import WHOLE, Views

_SUFFIXES = (".npy", ".png")
_FLAT = 0.25  # least length of a normal in a file; shorter ones are no normals


@dataclass(frozen=True)
class MapFormat:
    """Conventions of normal and depth maps in files.

    Attributes:
        normals_in: Space of the normals: "world", or "camera" for x right, y up, z towards the viewer.
        depth_scale: Steps of a depth .png for one unit of the world, > 0.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.fit import MapFormat
        >>> MapFormat(normals_in="camera").depth_scale
        1000.0
    """

    normals_in: Literal["world", "camera"] = "world"
    depth_scale: float = DEPTH_SCALE

    def __post_init__(self) -> None:
        if self.normals_in not in ("world", "camera"):
            raise ValueError(f'normals_in: expected "world" or "camera", got {self.normals_in!r}')
        validate.positive("depth_scale", self.depth_scale)


def load_maps(
    views: Views,
    found: Sequence[tuple[PosedImage, Path]],
    folders: Sequence[Path],
    full: tuple[int, int],
    conventions: MapFormat,
) -> Views:
    """Add maps in the folders ``normals`` and ``depth`` to views, if the folders have any; ValueError if one lacks.

    The views were found in the camera file, with their images; maps of the full size are reduced to that of the views.
    """
    files, entries = [file for _, file in found], [entry for entry, _ in found]
    normal_files, depth_files = (find_maps(files, folders, name) for name in ("normals", "depth"))
    masks = views.masks[:, None]
    if normal_files is not None:
        read = [read_normals(file, full) for file in normal_files]
        maps = [_reduced(each.movedim(2, 0), *rest) for each, rest in _with(read, entries, full, views.size)]
        normals = F.normalize(torch.stack(maps), dim=1) * masks
        views = replace(
            views, normals=to_world(normals, views.camera) if conventions.normals_in == "camera" else normals
        )
    if depth_files is not None:
        depths = [read_depth(file, full, conventions.depth_scale) for file in depth_files]
        layers = [torch.stack((each, (each > 0).to(each))) for each in depths]
        depth, known = torch.stack(
            [_reduced(each, *rest) for each, rest in _with(layers, entries, full, views.size)]
        ).unbind(1)
        views = replace(views, depth=torch.where(known > WHOLE, depth, 0.0))
    return views


def _with(maps: list[Tensor], entries: list[PosedImage], *sizes: tuple[int, int]) -> list[tuple[Tensor, Any]]:
    """Pair each map with its entry and the sizes."""
    return [(each, (entry, *sizes)) for each, entry in zip(maps, entries, strict=True)]


def _reduced(image: Tensor, entry: PosedImage, full: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """Undistort a map [C, H, W] like its image, and reduce it to a size."""
    if entry.lens.needs_undistortion:
        image = undistort(image, entry.lens.model, entry.lens.values, entry.lens.intrinsics(full))
    return F.interpolate(image[None], size, mode="area")[0]


def find_maps(images: Sequence[Path], folders: Sequence[Path], name: str) -> list[Path] | None:
    """Find the maps of all images: files with their names, .npy or .png, in a sibling folder called ``name``.

    It may also lie in one of the ``folders``. Returns None if there is none; FileNotFoundError: it has no map for an
    image.
    """
    places = [folder / name for folder in dict.fromkeys((images[0].parent, *folders)) if (folder / name).is_dir()]
    if not places:
        return None
    found = []
    for image in images:
        files = [place / (image.stem + suffix) for place in places for suffix in _SUFFIXES]
        file = next((file for file in files if file.is_file()), None)
        if file is None:
            raise FileNotFoundError(f"{places[0]}: expected a file {image.stem}.png or .npy for each image, got none")
        found.append(file)
    return found


def read_normals(path: Path, size: tuple[int, int]) -> Tensor:
    """Read a normal map, a .png with (n + 1) / 2 or a .npy, as unit vectors [H, W, 3], 0 where the file has none.

    Raises ValueError if it does not have the size (height, width), or cannot be read.
    """
    values = _array(path, 3) if path.suffix == ".npy" else 2 * load_image(path)[..., :3] - 1
    _check_size(path, values, size)
    length = values.norm(dim=2, keepdim=True)
    return torch.where((length > _FLAT) & length.isfinite(), F.normalize(values, dim=2), 0.0)


def read_depth(path: Path, size: tuple[int, int], scale: float) -> Tensor:
    """Read a depth map: depth along the viewing axis in world units, [H, W], 0 where the file has none.

    A .png has 16 bits, and ``scale`` steps for one unit of the world; a .npy is in world units. Raises ValueError if
    the file does not have the size (height, width), or cannot be read.
    """
    if path.suffix == ".npy":
        values = _array(path, 0)
    else:
        with reading_picture(str(existing(path))):
            file = open_picture(path)
        with file:
            check_pixels(path, file.width, file.height)
            if not file.mode.startswith("I"):
                raise ValueError(f"{path}: expected a grey picture of 16 bits, got one of mode {file.mode}")
            with reading_picture(str(path)):
                grey = np.asarray(file, dtype=np.float32)
        values = torch.from_numpy(grey / np.float32(scale))
    _check_size(path, values, size)
    return torch.where(values.isfinite() & (values > 0), values, 0.0)


def to_world(normals: Tensor, camera: Camera) -> Tensor:
    """Turn normals [N, 3, H, W] of camera space, x right, y up, z towards the viewer, to the world of N cameras."""
    right, up, forward = camera.axes.to(normals).unbind(1)
    return torch.einsum("nij,nihw->njhw", torch.stack((right, up, -forward), 1), normals)


def _array(path: Path, channels: int) -> Tensor:
    """Load an array [H, W] or [H, W, channels] of numbers as float32."""
    existing(path)
    try:
        values = np.lib.format.open_memmap(path, "r")  # its header may claim any size
    except Exception as error:  # of many classes for damaged headers
        raise ValueError(f"{path}: expected an array, got a file that cannot be read ({reason(error)})") from error
    shape = "[H, W, 3]" if channels else "[H, W]"
    if values.dtype.kind not in "fiu" or values.ndim != (3 if channels else 2) or values.shape[2:] not in ((), (3,)):
        raise ValueError(f"{path}: expected numbers {shape}, got {values.dtype} {list(values.shape)}")
    with np.errstate(over="ignore"):  # an infinite value means that there is no normal or depth
        return torch.from_numpy(values.astype(np.float32))


def _check_size(path: Path, values: Tensor, size: tuple[int, int]) -> None:
    """Raise ValueError if a map is not of the image's height and width."""
    if tuple(values.shape[:2]) != size:
        raise ValueError(
            f"{path}: expected {size[1]} x {size[0]} pixels like the image, got {values.shape[1]} x {values.shape[0]}"
        )
