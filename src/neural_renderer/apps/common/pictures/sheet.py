"""Contact sheets: pictures in rows with labels."""

from __future__ import annotations

import re
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
        place = height // 16, index * height + height // 20
        ImageDraw.Draw(image).text(place, _drawable(label), _INK, font, stroke_width=2, stroke_fill="white")
    return torch.from_numpy(np.array(image))


def captioned(pixels: Tensor, lines: Sequence[str]) -> Tensor:
    """Write lines of text below a picture [H, W, 3] uint8; two spaces begin a second column.

    The result is [taller, W, 3] uint8, on the CPU.
    """
    size = max(pixels.shape[1] // 80, _LEAST_FONT + 2)
    font, step = ImageFont.load_default(size), size * 3 // 2
    image = Image.new("RGB", (pixels.shape[1], pixels.shape[0] + step * (len(lines) + 1)), "white")
    image.paste(Image.fromarray(pixels.cpu().numpy()), (0, 0))
    for number, line in enumerate(lines):
        for column, text in enumerate(re.split("  +", line, maxsplit=1)):
            place = step + column * 10 * step, pixels.shape[0] + step // 2 + number * step
            ImageDraw.Draw(image).text(place, _drawable(text), _INK, font)
    return torch.from_numpy(np.array(image))


def _drawable(text: str) -> str:
    """Replace letters that the font does not have: those with accents by plain ones, others by "?"."""
    parts = unicodedata.normalize("NFKD", text)
    return "".join(part for part in parts if not unicodedata.combining(part)).encode("ascii", "replace").decode()
