"""Rules that separate an object from its background, for pictures without masks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ... import validate
from ...io import load_image
from .operations import dilate, erode, fill_holes, opened, remove_specks
from .plain_background import plain_background_mask

_CLEAR = 0.99  # an alpha channel that is nowhere below this tells nothing


@dataclass(frozen=True)
class MaskRule:
    """Rule that finds the mask of a picture without transparency.

    Attributes:
        background: RGB in [0, 1] of the background, or None.
        tolerance: Largest difference from ``background``, in any channel, of a background pixel, in [0, 1].
        below: Pixels whose brightest channel is below this, in [0, 1], are background; None for no threshold.
        opening: Radius in pixels of an erosion and dilation, which removes thin parts; ≥ 0.
        closing: Radii in pixels of a dilation and the erosion that follows it, which fill gaps; ≥ 0.
        fill: Holes smaller than this share of the object, in [0, 1], are filled.

    Raises:
        TypeError, ValueError: A value is out of range; the message calls it as `load_views` does.

    Example:
        >>> from neural_renderer.tasks.fit import MaskRule
        >>> MaskRule(below=0.2).find(torch.tensor([[[0.1, 0.1, 0.1], [0.9, 0.2, 0.2]]])).tolist()
        [[0.0, 1.0]]
    """

    background: tuple[float, float, float] | None = None
    tolerance: float = 0.05
    below: float | None = None
    opening: int = 0
    closing: tuple[int, int] = (0, 0)
    fill: float = 0.0

    def __post_init__(self) -> None:
        for value in self.background or ():
            if not 0 <= validate.number("background", value) <= 1:
                raise ValueError(f"background: expected red, green and blue in [0, 1], got {self.background}")
        if not 0 <= validate.number("tolerance", self.tolerance) <= 1:
            raise ValueError(f"tolerance: expected a number in [0, 1], got {self.tolerance}")
        if self.below is not None and not 0 < validate.number("mask_below", self.below) <= 1:
            raise ValueError(f"mask_below: expected a brightness above 0 and up to 1, got {self.below}")
        validate.whole("mask_open", self.opening, 0)
        for radius in self.closing:
            validate.whole("mask_close", radius, 0)
        if not 0 <= validate.number("mask_fill", self.fill) <= 1:
            raise ValueError(f"mask_fill: expected a share in [0, 1], got {self.fill}")

    def find(self, image: Tensor) -> Tensor:
        """Find the mask of a picture: by threshold or background colour, otherwise by its plain background.

        Args:
            image: [H, W, 3 or 4] in [0, 1], as `load_image` returns it.

        Returns:
            [H, W] in [0, 1], 1 on the object, without specks.

        Raises:
            ValueError: The rule is empty, and the background is not plain.
        """
        rgb = image[..., :3]
        if self.below is not None:
            mask = (rgb.amax(2) >= self.below).float()
        elif self.background is not None:
            mask = ((rgb - torch.tensor(self.background)).abs().amax(2) > self.tolerance).float()
        else:
            mask = plain_background_mask(image)
        if self.opening or any(self.closing):
            inside = opened(mask > 0.5, self.opening)
            mask = erode(dilate(inside, self.closing[0]), self.closing[1]).float()
        if self.fill:
            mask = torch.maximum(mask, fill_holes(mask > 0.5, self.fill).float())
        return remove_specks(mask) if bool((mask > 0.5).any()) else mask


def transparency(image: Tensor) -> Tensor | None:
    """Return the alpha channel [H, W] of a picture [H, W, C], or None if there is none or it is opaque everywhere."""
    return image[..., 3] if image.shape[2] == 4 and float(image[..., 3].min()) < _CLEAR else None


def mask_in_file(path: Path) -> Tensor:
    """Read a mask [H, W] in [0, 1]: the alpha channel of a picture with transparent pixels, else its brightness."""
    image = load_image(path)
    alpha = transparency(image)
    return image[..., :3].mean(2) if alpha is None else alpha
