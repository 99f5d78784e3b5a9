"""Writing of animations: GIF, and MP4 by ffmpeg."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from torch import Tensor

from ....base import validate
from ....io.atomic_write import replacing, write_file
from ....io.images import as_pixels, check_side, opaque
from .ffmpeg import frame_times, running, to_file
from .gif import encode_gif

_SUFFIXES = (".gif", ".mp4")
_MP4_QUALITY = "10"  # constant rate factor of H.264: 0 is lossless, 51 the worst


def save_animation(
    path: str | os.PathLike[str], frames: Iterable[Tensor | np.ndarray] | Tensor | np.ndarray, fps: float = 20
) -> None:
    """Write images as a looping GIF or as an MP4 (H.264), completely or not at all. Missing folders are made.

    Args:
        path: Name that ends in .gif or .mp4.
        frames: Tensor [N, 3, H, W] or any iterable of images as in `save_image`, all of one size. Transparent images
            are shown on white. MP4 needs even sides: the last row or column of odd ones is repeated.
        fps: Frames per second, > 0. GIF rounds the time of a frame to 1/100 s, at least 2/100 s.

    Raises:
        TypeError: ``frames`` or a frame has another type.
        ValueError: The suffix is unknown, ``fps`` is not > 0, there are no frames, or their sizes differ.
        OSError: The file cannot be written. An existing file stays as it was.

    Example:
        >>> eyes = nr.get_points_from_angles(2.7, 20.0, torch.arange(0.0, 360.0, 90.0))
        >>> nr.save_animation("turn.gif", nr.render(mesh, nr.Camera.look_at(eyes), 64).rgb, fps=10)
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(f"path: expected a name that ends in {', '.join(_SUFFIXES)}, got {path.name!r}")
    fps = validate.positive("fps", fps)
    try:
        frames = iter(frames)
    except TypeError:
        raise TypeError(f"frames: expected pictures, got {type(frames).__name__}") from None
    pictures: list[np.ndarray] = []
    for index, frame in enumerate(frames):
        picture = opaque(as_pixels(f"frames[{index}]", frame))
        if pictures and picture.shape != pictures[0].shape:
            first, other = (f"{p.shape[1]} x {p.shape[0]}" for p in (pictures[0], picture))
            raise ValueError(f"frames[{index}]: expected {first} pixels like the first frame, got {other}")
        pictures.append(picture)
    if not pictures:
        raise ValueError("frames: expected at least one, got none")
    check_side("frames", path, pictures[0])
    if suffix == ".gif":
        write_file(path, encode_gif(pictures, fps))
    else:
        with replacing(path) as fresh:
            _save_mp4(fresh, pictures, fps)


def _save_mp4(path: Path, pictures: list[np.ndarray], fps: float) -> None:
    """Encode images as an MP4 file. Raises OSError if the encoder fails or the file lacks images."""
    height, width = (side + side % 2 for side in pictures[0].shape[:2])
    rate = str(Fraction(fps).limit_denominator())
    form = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate]
    coding = ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", _MP4_QUALITY]
    pads = [(0, height - len(pictures[0])), (0, width - pictures[0].shape[1]), (0, 0)]
    try:
        with running([*form, "-i", "-", *coding, to_file(path)], reads=True) as encoder:
            for picture in pictures:
                encoder.write(np.pad(picture, pads, mode="edge").tobytes())
    except OSError as error:
        raise OSError(f"the encoder failed ({error})") from None
    if frame_times(path, len(pictures) + 1)[0] != len(pictures):
        raise OSError("the encoder wrote a file that cannot be played")
