"""Reading and writing of images."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageOps, UnidentifiedImageError
from torch import Tensor

from ..base import validate
from .atomic_write import write_file
from .files import as_tensor, existing, reason
from .image_formats.exr import write_exr
from .image_formats.pictures import FORMATS, check_pixels, open_picture
from .image_formats.png import encode_png
from .image_formats.radiance import radiance_bytes

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".hdr", ".exr")
_MOST_PIXELS = {".jpg": 65500, ".jpeg": 65500, ".gif": 65535, ".webp": 16383}  # pixels of a side
_JPEG_QUALITY = 95
_STRIP = 1 << 20  # pixels converted at once
_EXPLAINED = (OSError, SyntaxError, NotImplementedError, Image.DecompressionBombError)  # of Pillow, in its own words
_LEAST: ContextVar[int | None] = ContextVar("least", default=None)  # of `pictures_reduced`


def load_image(path: str | os.PathLike[str], *, upright: bool = False) -> Tensor:
    """Read an image file. Grey, palette, CMYK and 16-bit grey images are converted.

    Args:
        path: PNG, JPEG, WebP, TIFF, BMP, GIF, PPM, TGA, DDS or JPEG 2000 file, of any name.
        upright: Rotate a photo according to its EXIF orientation. Do not use it with calibrated cameras or texture
            coordinates: they refer to the pixels as stored.

    Returns:
        [H, W, 3] float32 in [0, 1], or [H, W, 4] if the image has transparency; row 0 at the top, on the CPU.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not an image, or it has more than ``PIL.Image.MAX_IMAGE_PIXELS`` pixels (89 million by
            default), with transparency three quarters of that. This is checked before decoding, so that a small file
            cannot fill the memory.

    Example:
        >>> nr.save_image("grey.png", torch.full((4, 6), 0.2))
        >>> nr.load_image("grey.png").shape
        torch.Size([4, 6, 3])
    """
    return load_reduced(path, upright=upright, least=_LEAST.get())[0]


def load_reduced(
    path: str | os.PathLike[str], *, upright: bool = False, least: int | None = None
) -> tuple[Tensor, tuple[int, int]]:
    """Read an image file as `load_image`, at a half, a quarter or an eighth of its sides if they can be divided so.

    The longer side keeps at least ``least`` pixels; None keeps the size. Colours are means, which the decoder of JPEG
    computes in a fraction of its time. Returns the image and its full height and width.
    """
    if not existing(path).stat().st_size:  # files in /proc have size 0 and may be endless
        raise ValueError(f"{path}: expected a picture, got an empty file")
    with reading_picture(str(path)):
        file = open_picture(path)
    with file:
        divisor = _divisor(file, least)
        pixels = torch.from_numpy(unpack(str(path), file, upright=upright, divisor=divisor))
    return pixels, (pixels.shape[0] * divisor, pixels.shape[1] * divisor)


def _divisor(file: Image.Image, least: int | None) -> int:
    width, height = file.size
    fits = (n for n in (8, 4, 2) if least and max(file.size) >= n * least and width % n == height % n == 0)
    return next(fits, 1) if file.mode in ("L", "RGB", "RGBA") else 1


@contextmanager
def pictures_reduced(least: int) -> Iterator[None]:
    """Reduce the pictures that `load_image` and readers of meshes read in the block, as `load_reduced` does."""
    token = _LEAST.set(least)
    try:
        yield
    finally:
        _LEAST.reset(token)


def size_of(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Read the height and width of a picture as its pixels are stored."""
    with reading_picture(str(path)), open_picture(path) as file:
        return file.height, file.width


def as_image(name: str, value: Any) -> Any:
    """Convert an image of Pillow to a tensor, as `load_image`, or an array or lists as `as_tensor`; keep the rest."""
    return torch.from_numpy(unpack(name, value)) if isinstance(value, Image.Image) else as_tensor(value)


def decode_picture(where: str, content: bytes, *more: str) -> np.ndarray:
    """Decode the content of a file, also in ``more`` formats, to the array of `load_image`, as `unpack`."""
    if not content:
        raise ValueError(f"{where}: expected a picture, got an empty file")
    with reading_picture(where):
        file = open_picture(io.BytesIO(content), *more)
    with file:
        return unpack(where, file, divisor=_divisor(file, _LEAST.get()))


def unpack(
    where: str, file: Image.Image, *, upright: bool = False, transparency: bool = True, divisor: int = 1
) -> np.ndarray:
    """Decode an open image to the array of `load_image`; messages call it ``where``.

    Without ``transparency``, an alpha channel is dropped. The sides are divided by ``divisor``, 1, 2, 4 or 8.
    """
    if file.format == "EPS":  # Pillow would run another program to draw it
        raise ValueError(f"{where}: expected a picture of pixels, got PostScript")
    with reading_picture(where):
        is_transparent = file.has_transparency_data  # it may look into the file
    check_pixels(where, file.width, file.height, 4 if transparency and is_transparent else 3)
    with reading_picture(where):
        size = file.width // divisor, file.height // divisor
        if divisor > 1 and not is_transparent:
            file.draft(None, size)  # means of blocks, by the decoder of JPEG
        image = ImageOps.exif_transpose(file) if upright else file
        image = image.reduce(file.width // size[0]) if file.width > size[0] else image
        deep = image.mode.startswith(("I", "F"))  # 16-bit grey; conversion to RGB would clip it at 255
        mode = "RGBA" if transparency and not deep and image.has_transparency_data else "RGB"
        full = np.float32((1 if image.mode.startswith("F") else 65535) if deep else 255)
        pixels = np.empty((image.height, image.width, len(mode)), np.float32)
        rows = max(1, _STRIP // image.width)
        for top in range(0, image.height, rows):  # in strips, to save memory
            strip = image.crop((0, top, image.width, min(top + rows, image.height)))
            if deep:
                colors = np.asarray(strip, np.float32).clip(0, full)[..., None]
            else:
                colors = np.asarray(strip if strip.mode == mode else strip.convert(mode))
            np.divide(colors, full, out=pixels[top : top + rows])
        return pixels


@contextmanager
def reading_picture(where: str) -> Iterator[None]:
    """Convert Pillow's errors, which have many classes, to ValueError; messages call the picture ``where``."""
    try:
        yield
    except UnidentifiedImageError as error:
        known = ", ".join(FORMATS)
        raise ValueError(f"{where}: expected a picture, got a file of an unknown format, none of {known}") from error
    except Exception as error:  # Pillow raises errors of many classes, some with Python's words
        why = f" ({reason(error)})" if isinstance(error, _EXPLAINED) else ""
        raise ValueError(f"{where}: expected a picture, got one that cannot be read{why}") from error


def save_image(path: str | os.PathLike[str], image: Tensor | np.ndarray) -> None:
    """Write an image as PNG, JPEG, Radiance or OpenEXR, completely or not at all. Missing folders are made.

    Args:
        path: Name that ends in .png, .jpg or .jpeg; or in .hdr or .exr (needs the extra "exr"), for linear light of any
            strength, as `EnvironmentLight.load` reads it.
        image: Tensor, array or picture of Pillow, [H, W], [H, W, C] or [C, H, W] with 1, 3 or 4 channels. Floats are
            clamped to [0, 1], uint8 is kept. JPEG shows transparent images on white; its sides are at most 65,500
            pixels. Floats for .hdr and .exr are kept, clamped to 0 in .hdr, which has no transparency.

    Raises:
        TypeError: ``image`` is not a tensor, array or picture.
        ValueError: The suffix or shape does not fit, a number is NaN, or all numbers of one channel, such as a depth,
            lie outside of [0, 1]; infinite for .hdr.
        ModuleNotFoundError: OpenEXR is not installed.
        OSError: The file cannot be written. An existing file stays as it was.

    Example:
        >>> nr.save_image("mesh.png", nr.render(mesh, camera, 64).rgb[0])
    """
    path = Path(path)
    if path.suffix.lower() not in _IMAGE_SUFFIXES:
        raise ValueError(f"path: expected a name that ends in {', '.join(_IMAGE_SUFFIXES)}, got {path.name!r}")
    if path.suffix.lower() in (".hdr", ".exr"):
        _save_light(path, _channels_last("image", image))
        return
    write_file(path, encode_image(path, image))


def encode_image(path: Path, image: Tensor | np.ndarray, fast: bool = False) -> bytes:
    """Encode an image, as `save_image` takes it, for a file of this name: .png, .jpg, .jpeg or .webp (without loss).

    A ``fast`` PNG takes a quarter of the time, and is a fifth larger.
    """
    pixels = as_pixels("image", image)
    check_side("image", path, pixels)
    suffix, file = path.suffix.lower(), io.BytesIO()
    if suffix == ".png" and fast:
        return encode_png(pixels)
    if suffix == ".png":
        Image.fromarray(pixels).save(file, "PNG")
    elif suffix == ".webp":
        Image.fromarray(pixels).save(file, "WEBP", lossless=True, exact=True, quality=0, method=0)
    else:
        Image.fromarray(opaque(pixels)).save(file, "JPEG", quality=_JPEG_QUALITY)
    return file.getvalue()


def check_side(name: str, path: Path, pixels: np.ndarray) -> None:
    """Raise ValueError if an image [H, W, …] is too large for its file format."""
    side, most = max(pixels.shape[:2]), _MOST_PIXELS.get(path.suffix.lower())
    if most is not None and side > most:
        raise ValueError(f"{name}: expected at most {most} pixels a side for {path.name!r}, got {side}")


def _save_light(path: Path, image: np.ndarray) -> None:
    values = image / np.float32(255) if image.dtype == np.uint8 else image.astype(np.float32)
    if path.suffix.lower() == ".exr":
        write_exr(path, values)
        return
    if not np.isfinite(values).all():
        raise ValueError(f"image: expected finite numbers, got {int((~np.isfinite(values)).sum())} that are not")
    rgb = np.repeat(values[..., None], 3, 2) if values.ndim == 2 else values[..., :3]
    write_file(path, radiance_bytes(rgb.clip(0, 1e38)))


def _channels_last(name: str, image: Any) -> np.ndarray:
    """Convert an image to an array [H, W], [H, W, 3] or [H, W, 4]; arguments and errors as `save_image`."""
    if isinstance(image, Tensor):
        image = validate.has_numbers(name, validate.dense(name, image)).detach().cpu().resolve_neg()
        image = (image.float() if image.is_floating_point() else image).numpy()
    if isinstance(image, Image.Image):
        image = unpack(name, image)
    if not isinstance(image, np.ndarray):
        raise TypeError(f"{name}: expected a tensor, an array or a picture of Pillow, got {type(image).__name__}")
    if image.ndim == 3 and image.shape[2] not in (1, 3, 4) and image.shape[0] in (1, 3, 4):
        image = np.moveaxis(image, 0, 2)
    if not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3, 4))) or 0 in image.shape:
        raise ValueError(f"{name}: expected [H, W], [H, W, 1|3|4] or [1|3|4, H, W], got {list(image.shape)}")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if np.isnan(image.min()):  # min is NaN if any pixel is, and needs no further array
        raise ValueError(f"{name}: expected numbers, got {int(np.isnan(image).sum())} that are NaN")
    return image


def as_pixels(name: str, image: Any) -> np.ndarray:
    """Convert an image to uint8, [H, W], [H, W, 3] or [H, W, 4]; arguments and errors as `save_image`."""
    image = _channels_last(name, image)
    if image.dtype != np.uint8:
        low, high = (image.min(), image.max()) if image.ndim == 2 else (0, 1)
        if low != high and (low >= 1 or high <= 0):
            raise ValueError(
                f"{name}: expected numbers in [0, 1], got {low:g} to {high:g}, which would be one shade; for a depth, "
                f"(far - depth) / (far - near) with the object's range"
            )
        image = image.astype(np.float32, copy=False).clip(0, 1)
        image *= 255  # in place, which takes half the time
        image += 0.5
        image = image.astype(np.uint8)
    if image.flags.c_contiguous or image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.stack(list(np.moveaxis(image, 2, 0)), 2)  # a third of the time


def opaque(pixels: np.ndarray) -> np.ndarray:
    """Convert an image to [H, W, 3] uint8: repeat grey, show transparency on white."""
    if pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, axis=2)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:].astype(np.float32) / 255
        pixels = (pixels[..., :3] * alpha + 255 * (1 - alpha) + 0.5).astype(np.uint8)
    return pixels
