"""COLMAP's text files."""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

from ...io.files import read_text, short

Camera = tuple[str, int, int, list[float]]  # model, width, height, parameters
Image = tuple[str, int, tuple[float, ...], tuple[float, ...]]  # name, camera, quaternion (w, x, y, z), translation


def read_text_cameras(path: Path) -> dict[int, Camera]:
    """Read ``cameras.txt``: cameras by number. Raises ValueError with the line if it is malformed."""
    cameras = {}
    for where, words in _lines(path):
        if words:
            if len(words) < 5:
                raise _malformed(where, "number, model, width, height and parameters", words)
            numbers = _numbers(where, [words[0], *words[2:]])
            cameras[int(numbers[0])] = words[1], int(numbers[1]), int(numbers[2]), numbers[3:]
    return cameras


def read_text_images(path: Path) -> dict[int, Image]:
    """Read ``images.txt``: images by number. Raises ValueError with the line if it is malformed.

    Each image has two lines. The second one lists its points, and may be empty.
    """
    images, lines = {}, list(_lines(path))
    while lines and not lines[0][1]:
        lines.pop(0)
    for where, words in lines[::2]:
        if not words:
            continue
        if len(words) < 10:
            raise _malformed(where, "number, quaternion, translation, camera and name", words)
        numbers = _numbers(where, words[:9])
        quaternion, translation = tuple(numbers[1:5]), tuple(numbers[5:8])
        images[int(numbers[0])] = " ".join(words[9:]), int(numbers[8]), quaternion, translation
    return images


def read_text_points(path: Path) -> Tensor:
    """Read the places of ``points3D.txt``, [P, 3] float64. Raises ValueError with the line if it is malformed."""
    places = []
    for where, words in _lines(path):
        if words:
            if len(words) < 4:
                raise _malformed(where, "number and place", words)
            places.append(_numbers(where, words[:4])[1:])
    return torch.tensor(places, dtype=torch.float64).reshape(-1, 3)


def _lines(path: Path) -> list[tuple[str, list[str]]]:
    """List the lines without comments: the place, for messages, and the words of each."""
    lines = enumerate(read_text(path).split("\n"), 1)
    return [(f"{path}: line {number}", line.split()) for number, line in lines if not line.startswith("#")]


def _numbers(where: str, words: list[str]) -> list[float]:
    """Convert words to finite numbers."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise _malformed(where, "finite numbers", words)
    return numbers


def _malformed(where: str, expected: str, words: list[str]) -> ValueError:
    return ValueError(f"{where}: expected {expected}, got {short(' '.join(words))}")
