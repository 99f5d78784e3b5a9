"""Posed images from files; see `camera_files` for the formats of cameras."""

from __future__ import annotations

import os
from pathlib import Path

import torch
from torch import Tensor

from ... import validate
from ...io import load_image
from ...io.files import existing
from .camera_files import Frame, camera_file, make_camera, read_frames
from .fit_views import Views, downscale

_LEAST_SIZE = 16  # pixels


def load_views(
    path: str | os.PathLike[str],
    *,
    size: int = 256,
    photos: bool = True,
    background: tuple[float, float, float] | None = None,
    tolerance: float = 0.05,
    allow_outside: bool = False,
) -> Views:
    """Load posed images from a folder.

    The mask of an image is, in this order: the mask file of its entry; its alpha channel; all pixels that differ from
    ``background``.

    Args:
        path: Camera file (``transforms.json``, ``cameras.json`` or ``cameras.csv``), or a folder that contains one. The
            module `camera_files` describes the formats.
        size: Longer side in pixels, ≥ 16; larger images are scaled down.
        photos: Whether to use colours. Without colours, an image without a mask is a mask itself, white on black.
        background: RGB in [0, 1] of the background, for images without mask and alpha channel.
        tolerance: Largest difference from ``background``, in any channel, of a background pixel.
        allow_outside: Whether the camera file may name images outside of its folder.

    Returns:
        The views, on the CPU.

    Raises:
        FileNotFoundError: The folder, the camera file or an image does not exist.
        ValueError: A file is malformed, a key is missing, image sizes differ, an image is larger than `load_image`
            accepts or outside of the folder without ``allow_outside``, a mask is empty, or ``background`` is None and
            an image has no mask and no alpha channel.

    Example:
        >>> disc = nr.render(nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 0.0, -2.7)), 64).alpha[0]
        >>> nr.save_image("photos/000.png", disc)
        >>> table = "file,azimuth,elevation,distance\\n000.png,0,0,2.7\\n"
        >>> _ = Path("photos/cameras.csv").write_text(table)
        >>> views = load_views("photos", size=32, photos=False)
        >>> len(views), views.size
        (1, (32, 32))
    """
    size = validate.whole("size", size, _LEAST_SIZE)
    _check_background(background)
    source = camera_file(Path(path))
    common, frames = read_frames(source, allow_outside)
    images: list[Tensor] = []
    masks: list[Tensor] = []
    full = (0, 0)
    for frame in frames:
        image = load_image(frame.image)
        full = full if images else (image.shape[0], image.shape[1])
        _same_size(frame.image, image, full)
        rgb, mask = _prepare(frame, image, size, photos, background, tolerance)
        images.append(rgb)
        masks.append(mask)
    camera = make_camera(source, common, frames, full)
    return Views(camera, torch.stack(masks), torch.stack(images) if photos else None)


def load_photo(
    path: str | os.PathLike[str],
    *,
    size: int = 256,
    photos: bool = True,
    background: tuple[float, float, float] | None = None,
    tolerance: float = 0.05,
) -> tuple[Tensor, Tensor | None]:
    """Load one image without a camera.

    Args:
        path: Image file.
        size: Longer side in pixels, ≥ 16; larger images are scaled down.
        photos: Whether to use colours; see `load_views`.
        background: RGB in [0, 1] of the background, for an image without alpha channel.
        tolerance: Largest difference from ``background``, in any channel, of a background pixel.

    Returns:
        The mask [H, W], and RGB multiplied by the mask [3, H, W], or None without ``photos``.

    Raises:
        OSError, TypeError, ValueError: As `load_views`.

    Example:
        >>> nr.save_image("disc.png", nr.render(nr.Mesh.icosphere(2), camera, 64).alpha[0])
        >>> mask, photo = load_photo("disc.png", size=32, photos=False)
        >>> mask.shape
        torch.Size([32, 32])
    """
    _check_background(background)
    frame = Frame(str(path), existing(path), None, {})
    image = load_image(path)
    rgb, mask = _prepare(frame, image, validate.whole("size", size, _LEAST_SIZE), photos, background, tolerance)
    return mask, rgb if photos else None


def _prepare(
    frame: Frame,
    image: Tensor,
    size: int,
    photos: bool,
    background: tuple[float, float, float] | None,
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    """Scale an image to the size of the fit: RGB multiplied by the mask [3, H, W], and mask [H, W]."""
    mask = _mask(frame, image, photos, background, tolerance)
    if float(mask.max()) <= 0.5:
        raise ValueError(f"{frame.mask or frame.image}: expected an object in the mask, got an empty one")
    return downscale((image[..., :3] * mask[..., None]).permute(2, 0, 1), size), downscale(mask[None], size)[0]


def _check_background(background: tuple[float, float, float] | None) -> None:
    """Raise ValueError if a colour is outside [0, 1]."""
    for value in background or ():
        if not 0 <= validate.number("background", value) <= 1:
            raise ValueError(f"background: expected red, green and blue in [0, 1], got {background}")


def _same_size(path: Path, image: Tensor, full: tuple[int, int]) -> None:
    """Raise ValueError if an image [H, W, C] is not of this height and width."""
    if tuple(image.shape[:2]) != full:
        raise ValueError(
            f"{path}: expected {full[1]} x {full[0]} pixels like the others, got {image.shape[1]} x {image.shape[0]}"
        )


def _mask(
    frame: Frame,
    image: Tensor,
    photos: bool,
    background: tuple[float, float, float] | None,
    tolerance: float,
) -> Tensor:
    """Find the mask of an image, [H, W] in [0, 1]; see `load_views`."""
    if frame.mask is not None:
        mask = load_image(frame.mask)
        _same_size(frame.mask, mask, (image.shape[0], image.shape[1]))
        transparent = mask.shape[2] == 4 and float(mask[..., 3].min()) < 1
        return mask[..., 3] if transparent else mask[..., :3].mean(2)
    if image.shape[2] == 4:
        return image[..., 3]
    if background is not None:
        return ((image - torch.tensor(background)).abs().amax(2) > tolerance).float()
    if not photos:
        return image.mean(2)
    raise ValueError(
        f"{frame.image}: expected an alpha channel, a mask or a background colour to separate the object, got none"
    )
