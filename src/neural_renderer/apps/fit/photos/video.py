"""Frames of a video: sharp ones, spaced by the change of the picture."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import IO

import numpy as np
from scipy import ndimage

from ....io.files import existing, reason
from ...common.pictures.ffmpeg import frame_times, from_file, running, to_file

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
"""Suffixes of videos."""
_CANDIDATES = 6  # frames among which each chosen one is the sharpest
_SIDE = 320  # pixels of the frames that are compared
_MOST_FRAMES = 100_000  # of a video: 28 minutes of 60 frames a second
_MOST_PIXELS = 400_000_000_000  # of all frames: 13 minutes of 3840 × 2160 pixels and 60 frames a second
_LARGEST = 1 << 26  # pixels of a frame
_LONGEST_LINE = 32  # bytes of width and height in the header of a PGM or PPM picture


def videos_in(folder: Path) -> list[Path]:
    """List the videos of a folder, in order."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in VIDEOS and file.is_file())


def choose_frames(video: Path, count: int, side: int) -> Iterator[tuple[int, float, np.ndarray]]:
    """Choose frames of a video: cut it where equal parts of all change have passed, and take the sharpest of each part.

    It is decoded once: candidates, at a reduced rate, are kept in a temporary file. Yields the number of each frame,
    its time in seconds, and its picture [H, W, 3] uint8 with at most ``side`` pixels. ValueError: The file is no
    video, or too long.
    """
    existing(video, "a video")
    try:
        with tempfile.TemporaryDirectory(prefix="neural_renderer-") as folder:
            kept = Path(folder) / "candidates.mkv"
            rate, greys = _candidates(video, count, side, kept)
            chosen = set(_sharpest(greys, count))
            with running([*from_file(kept), "-map", "0:v:0", *_pictures("ppm")]) as file:
                for number, frame in enumerate(_read_pictures(file)):
                    if number in chosen:
                        yield number, number / rate, frame
    except OSError as error:
        raise ValueError(f"{video}: expected a video, got one that cannot be read ({reason(error)})") from None


def _candidates(video: Path, count: int, side: int, kept: Path) -> tuple[float, list[tuple[float, np.ndarray]]]:
    """Decode a video: write candidates to a file; return their rate in frames a second, and the values of each.

    The values are the sharpness, and a small grey picture.
    """
    total, seconds, (width, height) = frame_times(video, _MOST_FRAMES + 1)
    if total > _MOST_FRAMES or total * width * height > _MOST_PIXELS:
        got = f"{'more' if total > _MOST_FRAMES else f'{total:,}'} of {width} × {height}"
        limit = f"{_MOST_FRAMES:,} frames and {_MOST_PIXELS:,} pixels in all"
        raise ValueError(f"{video}: expected at most {limit}, got {got}; cut it, or make it smaller")
    if not total or seconds <= 0:
        raise OSError("it has no frames")
    rate = min(total, _CANDIDATES * count) / seconds
    most = ["-frames:v", str(2 * _CANDIDATES * count)]  # times in a file may lie
    small, large = (
        f"fps={rate:.6f},scale='min({s},iw)':'min({s},ih)':force_original_aspect_ratio=decrease" for s in (_SIDE, side)
    )
    inputs = from_file(video, "-max_pixels", str(min(_LARGEST, _MOST_PIXELS // max(1, total))))
    first = ["-map", "0:v:0", "-vf", small, *most, *_pictures("pgm")]
    second = ["-map", "0:v:0", "-vf", large, *most, "-c:v", "ffv1", "-f", "matroska", to_file(kept)]
    with running([*inputs, *first, *second]) as file:
        values = [(sharpness(grey), grey[::8, ::8].astype(np.float32)) for grey in _read_pictures(file)]
    return rate, values


def _pictures(codec: str) -> list[str]:
    return ["-c:v", codec, "-pix_fmt", "rgb24" if codec == "ppm" else "gray", "-f", "image2pipe", "pipe:1"]


def _sharpest(values: list[tuple[float, np.ndarray]], count: int) -> list[int]:
    """Return the numbers of the sharpest frames in parts of equal change."""
    changes = [0.0, *(float(np.abs(b - a).mean()) for (_, a), (_, b) in pairwise(values))]
    passed = np.cumsum(changes[: len(values)])
    part = np.minimum(passed / max(passed[-1] if len(passed) else 0.0, 1e-9) * count, count - 1e-6).astype(int)
    sharp = np.array([sharp for sharp, _ in values])
    rows = (np.flatnonzero(part == number) for number in range(count))
    return [int(row[np.argmax(sharp[row])]) for row in rows if len(row)]


def sharpness(grey: np.ndarray) -> float:
    """Measure how sharp a grey picture [H, W] is: the deviation of its Laplacian, relative to its contrast."""
    values = ndimage.gaussian_filter(grey.astype(np.float32), 1)
    return float(ndimage.laplace(values).std() / max(float(values.std()), 1e-3))


def _read_pictures(file: IO[bytes]) -> Iterator[np.ndarray]:
    """Read pictures in the formats PGM and PPM of 8 bits, one after the other: [H, W] or [H, W, 3] uint8."""
    while kind := file.readline(4).strip():
        size, depth = file.readline(_LONGEST_LINE).split(), file.readline(8).strip()
        if kind not in (b"P5", b"P6") or depth != b"255":
            raise OSError(f"expected pictures of 8 bits, got {kind!r}")
        shape = int(size[1]), int(size[0]), *((3,) if kind == b"P6" else ())
        data = file.read(int(np.prod(shape)))
        if len(data) < np.prod(shape):
            raise OSError("the last picture is cut")
        yield np.frombuffer(data, np.uint8).reshape(shape)
