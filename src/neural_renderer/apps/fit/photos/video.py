"""Frames of a video: sharp ones, spaced by how much the picture changes."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from scipy import ndimage

from ....io.files import reason

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
"""Suffixes of videos."""
_CANDIDATES = 6  # frames among which each chosen one is the sharpest
_SIDE = 320  # pixels of the frames that are compared


def videos_in(folder: Path) -> list[Path]:
    """List the videos of a folder, in order."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in VIDEOS and file.is_file())


def choose_frames(video: Path, count: int) -> tuple[list[int], float]:
    """Choose frames of a video: cut it where equal parts of all change have passed, and take the sharpest of each part.

    Returns their numbers among the frames at a reduced rate, and this rate in frames per second. ValueError: The file
    is no video.
    """
    try:
        total, seconds = imageio_ffmpeg.count_frames_and_secs(str(video))
        rate = min(total, _CANDIDATES * count) / seconds
        values, passed, before = [], [0.0], None
        for _, frame in read_frames(video, rate, _SIDE):
            grey = frame.mean(2)
            values.append(sharpness(grey))
            small = grey[::8, ::8]
            passed.append(passed[-1] + (0.0 if before is None else float(np.abs(small - before).mean())))
            before = small
    except (OSError, RuntimeError, ZeroDivisionError) as error:
        raise ValueError(f"{video}: expected a video, got one that cannot be read ({reason(error)})") from None
    part = np.minimum(np.array(passed[1:]) / max(passed[-1], 1e-9) * count, count - 1e-6).astype(int)
    rows = (np.flatnonzero(part == number) for number in range(count))
    return [int(row[np.argmax(np.array(values)[row])]) for row in rows if len(row)], rate


def read_frames(
    video: Path, rate: float, side: int, chosen: Sequence[int] | None = None
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield frames [H, W, 3] uint8 of a video at a rate, with at most ``side`` pixels, and their numbers."""
    scale = f"scale='min({side},iw)':'min({side},ih)':force_original_aspect_ratio=decrease:force_divisible_by=2"
    logging.getLogger("imageio_ffmpeg").setLevel(logging.ERROR)  # it warns of each reduced size
    reader = imageio_ffmpeg.read_frames(str(video), output_params=["-vf", f"fps={rate:.6f},{scale}"])
    width, height = next(reader)["size"]
    wanted = None if chosen is None else set(chosen)
    for number, data in enumerate(reader):
        if wanted is None or number in wanted:
            yield number, np.frombuffer(data, np.uint8).reshape(height, width, 3)


def sharpness(grey: np.ndarray) -> float:
    """Measure how sharp a grey picture [H, W] is: the deviation of its Laplacian, relative to its contrast."""
    values = ndimage.gaussian_filter(grey.astype(np.float32), 1)
    return float(ndimage.laplace(values).std() / max(float(values.std()), 1e-3))
