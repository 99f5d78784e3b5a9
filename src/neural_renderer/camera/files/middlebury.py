"""``*_par.txt`` of the Middlebury multi-view data sets: K, R and t of each image in one line.

The first line is the number of images. Each further line is a name and 21 numbers: K and R by rows, and t.
"""

from __future__ import annotations

from pathlib import Path

import torch

from ...io.files import read_text, short
from .keys import LARGEST, check_rotation
from .lens_models import Lens
from .opencv import intrinsic_values
from .posed import CameraFile, PosedImage

_NUMBERS = 21


def read_middlebury(path: Path) -> CameraFile:
    """Read a file; raises ValueError with the line if it is malformed."""
    lines = [(number, line.split()) for number, line in enumerate(read_text(path).split("\n"), 1) if line.strip()]
    if lines and len(lines[0][1]) == 1:
        lines = lines[1:]
    if not lines:
        raise ValueError(f"{path}: expected at least one image, got none")
    images = []
    for line, words in lines:
        where = f"{path}: line {line}"
        try:
            values = torch.tensor([float(word) for word in words[1:]], dtype=torch.float64)
        except ValueError:
            values = torch.zeros(0)
        if len(values) != _NUMBERS or not bool((values.abs() <= LARGEST).all()):
            raise ValueError(f"{where}: expected a name and {_NUMBERS} finite numbers, got {short(' '.join(words))}")
        K, rotation = values[:9].view(3, 3), values[9:18].view(3, 3)
        check_rotation(where, "R", rotation, rotation.tolist())
        images.append(PosedImage(where, words[0], rotation, values[18:], Lens("OPENCV", intrinsic_values(where, K))))
    return CameraFile(path, images, (path.parent,))
