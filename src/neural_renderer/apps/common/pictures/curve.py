"""Plots of losses over the steps of a run."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

_INKS = (196, 78, 62), (52, 110, 180)  # colours of the left and of the right curve
_LINES, _TEXT = (200, 200, 200), (120, 120, 120)
_HEIGHT, _WIDTH, _FONT_SIZE = 420, 720, 14  # pixels


def curve(history: Sequence[dict[str, Any]], left: str, right: str, logarithmic: bool = True) -> np.ndarray:
    """Plot two numbers over the steps of a run: [H, W, 3] uint8. Vertical lines separate phases.

    A row of the history has the "phase" of a step and numbers by name, some of which may be missing. ``logarithmic`` is
    about the left axis.
    """
    image = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(_FONT_SIZE)
    low_x, high_x, top, bottom = 60, _WIDTH - 60, 30, _HEIGHT - 40
    draw.rectangle((low_x, top, high_x, bottom), outline=_LINES)
    across = (high_x - low_x) / max(len(history) - 1, 1)
    for index in range(1, len(history)):
        if history[index]["phase"] != history[index - 1]["phase"]:
            draw.line((low_x + index * across, top, low_x + index * across, bottom), fill=_LINES)
            draw.text((low_x + index * across + 4, top + 4), history[index]["phase"], _TEXT, font)
    for name, ink, side in zip((left, right), _INKS, (4, high_x + 4), strict=True):
        steps = [index for index, row in enumerate(history) if name in row]
        if not steps:
            continue
        values = torch.tensor([float(history[index][name]) for index in steps])
        scaled = values.clamp(min=1e-8).log10() if logarithmic and name == left else values
        low, high = float(scaled.min()), float(scaled.max())
        span = max(high - low, 1e-6)
        points = [
            (low_x + i * across, bottom - (float(v) - low) / span * (bottom - top))
            for i, v in zip(steps, scaled, strict=True)
        ]
        for (start, here), (end, there) in pairwise(zip(steps, points, strict=True)):
            if history[start]["phase"] == history[end]["phase"]:  # phases have different losses
                draw.line((here, there), fill=ink, width=2)
        draw.text((side, top - 18), f"{name} (log)" if logarithmic and name == left else name, ink, font)
        draw.text((side, top), f"{float(values.max()):.3g}", ink, font)
        draw.text((side, bottom - 14), f"{float(values.min()):.3g}", ink, font)
    draw.text((low_x, bottom + 10), f"{len(history)} steps", _TEXT, font)
    return np.asarray(image)
