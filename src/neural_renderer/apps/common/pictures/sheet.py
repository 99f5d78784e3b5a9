"""Contact sheets: pictures in rows with labels."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

_INK = (70, 76, 88)
_LEAST_FONT = 10  # pixels


def sheet(rows: Sequence[Sequence[Tensor]], labels: Sequence[str] = ()) -> Tensor:
    """Arrange pictures [3, H, W] in [0, 1] in rows of equal length: [rows · H, columns · W, 3] uint8, on the CPU.

    Labels stand in the upper left corners of the first rows.
    """
    whole = torch.cat([torch.cat(list(row), dim=2) for row in rows], dim=1).cpu()
    pixels = (whole.permute(1, 2, 0) * 255 + 0.5).to(torch.uint8).numpy()
    image = Image.fromarray(pixels)
    height = rows[0][0].shape[1]
    font = ImageFont.load_default(max(height // 14, _LEAST_FONT))
    for index, label in enumerate(labels):
        ImageDraw.Draw(image).text((height // 16, index * height + height // 20), _drawable(label), _INK, font)
    return torch.from_numpy(np.array(image))


def _drawable(text: str) -> str:
    """Replace letters that the font does not have: those with accents by plain ones, others by "?"."""
    parts = unicodedata.normalize("NFKD", text)
    return "".join(part for part in parts if not unicodedata.combining(part)).encode("ascii", "replace").decode()
