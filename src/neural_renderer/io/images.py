"""Pictures and animations in files."""

from __future__ import annotations

import io
import os
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import torch
from PIL import Image, ImageOps
from torch import Tensor

from .. import validate
from .atomic_write import replacing, write_file
from .files import existing, reason

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
_ANIMATION_SUFFIXES = (".gif", ".mp4")
_MOST_PIXELS = {".jpg": 65500, ".jpeg": 65500, ".gif": 65535}  # along a side


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
    if file.format == "EPS":  # to draw it, Pillow would run another program on it
        raise ValueError(f"{where}: expected a picture of pixels, got PostScript")
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
    in [0, 1] are clamped, uint8 is taken as it is. JPEG shows a transparent picture on white, and has at most 65,500
    pixels a side. Raises ValueError for another suffix or shape and for NaN, TypeError for no array, OSError where the
    file cannot be written; then a file that was there before stays.
    """
    path = Path(path)
    if path.suffix.lower() not in _IMAGE_SUFFIXES:
        raise ValueError(f"path: expected a name that ends in {', '.join(_IMAGE_SUFFIXES)}, got {path.name!r}")
    pixels = _pixels("image", image)
    _check_side("image", path, pixels)
    file = io.BytesIO()
    if path.suffix.lower() == ".png":
        Image.fromarray(pixels).save(file, "PNG")
    else:
        Image.fromarray(_opaque(pixels)).save(file, "JPEG", quality=95)
    write_file(path, file.getvalue())


def save_animation(
    path: str | os.PathLike[str], frames: Iterable[Tensor | np.ndarray] | Tensor | np.ndarray, fps: float = 20
) -> None:
    """Write pictures as a GIF that repeats forever or as an MP4 (H.264), chosen by the suffix; makes missing folders.

    ``frames`` is anything that gives pictures as `save_image` takes them, all of one size, for example a tensor
    [N, 3, H, W]. Transparent ones are shown on white. GIF times are multiples of 1/100 s, at least 2/100. MP4 pictures
    of odd width or height get their last column or row twice, because the format wants even ones. Raises ValueError
    for another suffix, fps not above 0, no frames, and frames of different sizes; TypeError for other types; OSError
    where the file cannot be written, and then a file that was there before stays.
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
    _check_side("frames", path, pictures[0])
    if suffix == ".gif":
        write_file(path, _gif(pictures, fps))
    else:
        with replacing(path) as fresh:
            _save_mp4(fresh, pictures, fps)


def _check_side(name: str, path: Path, pixels: np.ndarray) -> None:
    side, most = max(pixels.shape[:2]), _MOST_PIXELS.get(path.suffix.lower())
    if most is not None and side > most:
        raise ValueError(f"{name}: expected at most {most} pixels a side for {path.name!r}, got {side}")


def _gif(pictures: list[np.ndarray], fps: float) -> bytes:
    # Each picture gets its own 256 colours; without dithering, whose noise would crawl over a still background.
    images = [Image.fromarray(p).quantize(256, dither=Image.Dither.NONE) for p in pictures]
    duration, file = 10 * max(2, round(100 / fps)), io.BytesIO()
    images[0].save(file, "GIF", save_all=True, append_images=images[1:], duration=duration, loop=0, disposal=1)
    return file.getvalue()


def _save_mp4(path: Path, pictures: list[np.ndarray], fps: float) -> None:
    """Run the encoder; OSError says what it said unless it succeeded and every picture is found in the file."""
    height, width = (side + side % 2 for side in pictures[0].shape[:2])
    rate = str(Fraction(fps).limit_denominator())
    form = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate]
    coding = ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "10"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", *form, "-i", "-", *coding, str(path)]
    pads = [(0, height - len(pictures[0])), (0, width - pictures[0].shape[1]), (0, 0)]
    with tempfile.TemporaryFile() as told:  # a pipe could fill up
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=told) as encoder:
            with suppress(BrokenPipeError):  # it has ended, and says why
                for picture in pictures:
                    encoder.stdin.write(np.pad(picture, pads, mode="edge").tobytes())  # type: ignore[union-attr]
            encoder.communicate()
        told.seek(0)
        said = told.read().decode(errors="replace").strip().rpartition("\n")[2].rpartition("] ")[2]
    if encoder.returncode:
        raise OSError(f"the encoder failed ({said or f'exit status {encoder.returncode}'})")
    if imageio_ffmpeg.count_frames_and_secs(str(path))[0] != len(pictures):
        raise OSError("the encoder wrote a file that cannot be played")


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
