"""Pictures and animations in files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import torch
from PIL import Image, ImageOps
from torch import Tensor

from .. import validate
from .files import existing, reason

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
_ANIMATION_SUFFIXES = (".gif", ".mp4")


def load_image(path: str | os.PathLike[str], *, upright: bool = False) -> Tensor:
    """Read a picture: float32 [H, W, 3], or [H, W, 4] if it has transparency, in [0, 1], first row on top, on the CPU.

    Grey, palette, CMYK and 16-bit grey pictures are converted. ``upright`` turns a photo the way its camera noted to
    have been held (EXIF); calibrated cameras and texture coordinates belong to the pixels as they are stored.

    Raises FileNotFoundError if there is no such file, and ValueError if it is no picture or has more pixels than
    ``PIL.Image.MAX_IMAGE_PIXELS`` (89 million, unless a program sets another number). The size is read before the
    pixels are unpacked, so that a small file cannot fill the memory.
    """
    if not existing(path).stat().st_size:  # as of files in /proc, which may never end
        raise ValueError(f"{path}: expected a picture, got an empty file")
    with _reading(str(path)):
        file = Image.open(path)
    with file:
        return torch.from_numpy(unpack(str(path), file, upright=upright))


def unpack(where: str, file: Image.Image, *, upright: bool = False, transparency: bool = True) -> np.ndarray:
    """The pixels of a picture that is open, as `load_image` gives them; without transparency if it is not wanted.

    ``where`` is what the errors call it. Raises ValueError for a picture that is broken or too large.
    """
    limit = Image.MAX_IMAGE_PIXELS
    if limit is not None and file.width * file.height > limit:
        raise ValueError(
            f"{where}: expected a picture of at most {limit:,} pixels, got {file.width} x {file.height}; "
            "a program may raise PIL.Image.MAX_IMAGE_PIXELS"
        )
    with _reading(where):
        image = ImageOps.exif_transpose(file) if upright else file
        if image.mode.startswith(("I", "F")):  # 16-bit grey, which a conversion to RGB would cut off at 255
            full = 1 if image.mode.startswith("F") else 65535
            grey = np.asarray(image, dtype=np.float32).clip(0, full) / np.float32(full)
            return np.repeat(grey[..., None], 3, axis=2)
        mode = "RGBA" if transparency and image.has_transparency_data else "RGB"
        pixels = np.array(image if image.mode == mode else image.convert(mode), dtype=np.float32)
        pixels /= 255  # in place: a copy of a large picture is much memory
        return pixels


@contextmanager
def _reading(where: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # Pillow's errors for broken files are of many kinds
        raise ValueError(
            f"{where}: expected a picture, got a file that cannot be read as one ({reason(error)})"
        ) from error


def save_image(path: str | os.PathLike[str], image: Tensor | np.ndarray) -> None:
    """Write a picture as PNG or JPEG, chosen by the suffix; missing folders are made.

    ``image`` is a tensor or array, [H, W], [H, W, 1 | 3 | 4] or, as the renderer returns it, [1 | 3 | 4, H, W]; floats
    in [0, 1] are clamped, uint8 is taken as it is. JPEG shows a transparent picture on white. Raises ValueError for
    another suffix or shape and for NaN, TypeError for no array.
    """
    path = Path(path)
    if path.suffix.lower() not in _IMAGE_SUFFIXES:
        raise ValueError(f"path: expected a name that ends in {', '.join(_IMAGE_SUFFIXES)}, got {path.name!r}")
    pixels = _pixels("image", image)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".png":
        Image.fromarray(pixels).save(path)
    else:
        Image.fromarray(_opaque(pixels)).save(path, quality=95)


def save_animation(
    path: str | os.PathLike[str], frames: Iterable[Tensor | np.ndarray] | Tensor | np.ndarray, fps: float = 20
) -> None:
    """Write pictures as a GIF that repeats forever or as an MP4 (H.264), chosen by the suffix; makes missing folders.

    ``frames`` is anything that gives pictures as `save_image` takes them, all of one size, for example a tensor
    [N, 3, H, W]. Transparent ones are shown on white. GIF times are multiples of 1/100 s, at least 2/100. MP4 pictures
    of odd width or height get their last column or row twice, because the format wants even ones. Raises ValueError
    for another suffix, fps not above 0, no frames, and frames of different sizes; TypeError for other types.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _ANIMATION_SUFFIXES:
        raise ValueError(f"path: expected a name that ends in {', '.join(_ANIMATION_SUFFIXES)}, got {path.name!r}")
    fps = validate.positive("fps", fps)
    try:
        frames = iter(frames)
    except TypeError:
        raise TypeError(f"frames: expected pictures, got {type(frames).__name__}") from None
    pictures: list[np.ndarray] = []
    for index, frame in enumerate(frames):
        picture = _opaque(_pixels(f"frames[{index}]", frame))
        if pictures and picture.shape != pictures[0].shape:
            first, other = (f"{p.shape[1]} x {p.shape[0]}" for p in (pictures[0], picture))
            raise ValueError(f"frames[{index}]: expected {first} pixels like the first frame, got {other}")
        pictures.append(picture)
    if not pictures:
        raise ValueError("frames: expected at least one, got none")
    path.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".gif":
        _save_gif(path, pictures, fps)
    else:
        _save_mp4(path, pictures, fps)


def _save_gif(path: Path, pictures: list[np.ndarray], fps: float) -> None:
    # Each picture gets its own 256 colours; without dithering, whose noise would crawl over a still background.
    images = [Image.fromarray(p).quantize(256, dither=Image.Dither.NONE) for p in pictures]
    duration = 10 * max(2, round(100 / fps))
    images[0].save(path, save_all=True, append_images=images[1:], duration=duration, loop=0, disposal=1)


def _save_mp4(path: Path, pictures: list[np.ndarray], fps: float) -> None:
    height, width = pictures[0].shape[:2]
    writer = imageio.get_writer(
        path, format="FFMPEG", mode="I", fps=fps, codec="libx264", pixelformat="yuv420p", quality=8, macro_block_size=2
    )  # type: ignore[call-overload, unused-ignore]
    with writer:
        for picture in pictures:
            writer.append_data(np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge"))


def _pixels(name: str, image: Any) -> np.ndarray:
    """A picture as uint8, [H, W] or [H, W, 3 | 4]."""
    if isinstance(image, Tensor):
        image = validate.has_numbers(name, validate.dense(name, image)).detach().cpu().resolve_neg()
        image = (image.float() if image.is_floating_point() else image).numpy()
    if not isinstance(image, np.ndarray):
        raise TypeError(f"{name}: expected a tensor or array, got {type(image).__name__}")
    if image.ndim == 3 and image.shape[2] not in (1, 3, 4) and image.shape[0] in (1, 3, 4):
        image = np.moveaxis(image, 0, 2)
    if not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3, 4))) or 0 in image.shape:
        raise ValueError(f"{name}: expected [H, W], [H, W, 1|3|4] or [1|3|4, H, W], got {list(image.shape)}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.dtype != np.uint8:
        if np.isnan(image).any():
            raise ValueError(f"{name}: expected numbers, got {int(np.isnan(image).sum())} that are NaN")
        image = (image.astype(np.float32).clip(0, 1) * 255 + 0.5).astype(np.uint8)
    return np.ascontiguousarray(image)


def _opaque(pixels: np.ndarray) -> np.ndarray:
    """[H, W, 3] uint8: grey repeated, transparency shown on white."""
    if pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, axis=2)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:].astype(np.float32) / 255
        pixels = (pixels[..., :3] * alpha + 255 * (1 - alpha) + 0.5).astype(np.uint8)
    return pixels
