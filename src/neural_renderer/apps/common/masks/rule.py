"""Segmentation by rules: threshold, background colour, plain background, or box; for pictures without masks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from ....base import validate
from ....io import load_image
from ..checks import PICTURE_SUFFIXES as PICTURE_SUFFIXES
from ..options import MaskOptions
from .operations import (
    SMALL_HOLE,
    dilate,
    erode,
    fill_holes,
    limit_size,
    mixed_at_outline,
    opened,
    remove_specks,
    resize,
)

_CLEAR = 0.99  # an alpha channel that is nowhere below this is opaque, and no mask
MOST_SEARCHED = 640
"""Larger side in pixels, to which pictures are scaled down to separate an object."""

# A plain background: a quadratic function of position, fitted robustly to the border of the picture.
_BORDER = 0.02  # width of the border, relative to the shorter side
_BACKGROUND_SHARE = 0.65  # least share of background in the border
_SMOOTH = 9  # side in pixels of the averaging windows: they remove noise, but not a pattern
_ITERATIONS = 8  # of least trimmed squares: each fits the pixels with the smallest residuals
_LEAST_RESIDUAL = 0.02  # residuals below this always count as background
_LEAST_THRESHOLD, _NOISES = 0.06, 5  # distance of the object from the background: at least, and in noise levels
_MOST_THRESHOLD = 0.25  # of that; above it the background is not plain
_LEVELS = 16  # of each channel in a histogram of colours
_ELLIPSE = 0.7  # square of the radius of the first object in a box, relative to the box
_MOST_BOX = 0.98  # share of the picture that a box may cover


class BusyBackground(ValueError):
    """Error of a picture whose background is not plain."""


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
        >>> from neural_renderer.apps.fit import MaskRule
        >>> MaskRule(below=0.2).find(torch.tensor([[[0.1, 0.1, 0.1], [0.9, 0.2, 0.2]]])).tolist()
        [[0.0, 1.0]]
        >>> MaskRule(closing=(10, 7)).reduced(2).closing
        (5, 4)
    """

    background: tuple[float, float, float] | None = MaskOptions.background
    tolerance: float = MaskOptions.tolerance
    below: float | None = MaskOptions.mask_below
    opening: int = MaskOptions.mask_open
    closing: tuple[int, int] = MaskOptions.mask_close
    fill: float = MaskOptions.mask_fill

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

    def reduced(self, divisor: float) -> MaskRule:
        """Convert the radii for pictures whose sides are divided.

        Args:
            divisor: What the sides are divided by.

        Returns:
            The rule.
        """
        first, second = (round(radius / divisor) for radius in self.closing)
        return replace(self, opening=round(self.opening / divisor), closing=(first, second))

    def find(self, image: Tensor) -> Tensor:
        """Find the mask of a picture: by threshold or background colour, otherwise by its plain background.

        Args:
            image: [H, W, 3 or 4] in [0, 1], as `load_image` returns it.

        Returns:
            [H, W] in [0, 1], 1 on the object, without specks.

        Raises:
            ValueError: The rule is empty, and the background is not plain.
        """
        rgb, rule, size = image[..., :3], self, (image.shape[0], image.shape[1])
        if self.below is not None:
            mask = (rgb.amax(2) >= self.below).float()
        elif self.background is not None:
            mask = ((rgb - torch.tensor(self.background)).abs().amax(2) > self.tolerance).float()
        else:
            rgb = limit_size(rgb, MOST_SEARCHED)
            mask, rule = plain_background_mask(rgb), self.reduced(max(size) / max(rgb.shape))
        if rule.opening or any(rule.closing):
            inside = opened(mask > 0.5, rule.opening)
            mask = erode(dilate(inside, rule.closing[0]), rule.closing[1]).float()
        if self.fill:
            mask = torch.maximum(mask, fill_holes(mask > 0.5, self.fill).float())
        if bool((mask > 0.5).any()):
            mask = remove_specks(mask)
        if not self.opening and not any(self.closing):  # which may leave a margin on purpose
            mask = mixed_at_outline(mask, rgb)
        return resize(mask[None], size)[0]


def plain_background_mask(image: Tensor) -> Tensor:
    """Separate an object from a plain background, such as a wall or paper in uneven light: [H, W] in [0, 1].

    The background is a quadratic function of position, fitted to the border of the picture [H, W, 3 or 4], whose alpha
    is ignored. Up to a third of the border may show the object. `BusyBackground`: The background is not plain.
    """
    rgb = limit_size(image[..., :3], MOST_SEARCHED).permute(2, 0, 1)
    background, error, noise = _fit_border(rgb)
    threshold = max(_LEAST_THRESHOLD, _NOISES * noise)
    if threshold > _MOST_THRESHOLD or float((error > threshold).float().mean()) > 1 - _BACKGROUND_SHARE:
        raise BusyBackground(
            "expected transparency, a mask, or a plain background around the object, got many colours at the border"
        )
    distance = (rgb - background).abs().amax(0)
    alpha = (distance > threshold).float()
    return resize(alpha[None], (image.shape[0], image.shape[1]))[0]


def border_pattern(image: Tensor) -> float:
    """Measure the strength of a background's pattern, [H, W, 3 or 4]: its residuals without noise."""
    rgb = limit_size(image[..., :3], MOST_SEARCHED).permute(2, 0, 1)
    return _fit_border(F.avg_pool2d(rgb, _SMOOTH, 1, _SMOOTH // 2, count_include_pad=False))[2]


def _fit_border(rgb: Tensor) -> tuple[Tensor, Tensor, float]:
    """Fit a background [3, H, W] to the border of a picture; return also the border's residuals [N] and their noise."""
    height, width = rgb.shape[1:]
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    basis = torch.stack((torch.ones_like(x), x, y, x * x, x * y, y * y), -1)
    depth = max(1, round(_BORDER * min(height, width)))
    border = torch.ones(height, width, dtype=torch.bool)
    border[depth:-depth, depth:-depth] = False
    places, colors = basis[border], rgb[:, border].t()
    # Start from the median colour; then fit to the pixels that are closest to the background so far.
    error = (colors - colors.median(0).values).abs().amax(1)
    for _ in range(_ITERATIONS):
        kept = error <= max(float(error.quantile(_BACKGROUND_SHARE)), _LEAST_RESIDUAL)
        coefficients = torch.linalg.lstsq(places[kept].double(), colors[kept].double()).solution.float()
        error = (colors - places @ coefficients).abs().amax(1)
    noise = float(error[error <= error.quantile(_BACKGROUND_SHARE)].square().mean().sqrt())
    return (basis @ coefficients).permute(2, 0, 1), error, noise


def box_mask(image: Tensor, box: tuple[float, float, float, float], rounds: int = 4) -> Tensor:
    """Separate an object from any background by a box around it: the colours outside of the box are background.

    Histograms of colours describe object and background. Pixels in the box go to the likelier one, with their
    neighbours, and the object's histogram follows (a simple GrabCut: Rother, Kolmogorov and Blake, 2004).

    Args:
        image: [H, W, 3 or 4] in [0, 1]; alpha is ignored.
        box: Left, top, right and bottom, as shares of width and height in [0, 1].
        rounds: Rounds of assignment and description.

    Returns:
        [H, W] in [0, 1], 1 on the object.

    Raises:
        ValueError: The box is empty or leaves no background.
    """
    left, top, right, bottom = box
    if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1 and (right - left) * (bottom - top) < _MOST_BOX):
        raise ValueError(f"box: expected left < right and top < bottom in [0, 1], and background outside, got {box}")
    rgb = limit_size(image[..., :3], MOST_SEARCHED)
    height, width = rgb.shape[:2]
    y, x = torch.meshgrid((torch.arange(height) + 0.5) / height, (torch.arange(width) + 0.5) / width, indexing="ij")
    inside = (x > left) & (x < right) & (y > top) & (y < bottom)
    across, down = (x - (left + right) / 2) / (right - left) * 2, (y - (top + bottom) / 2) / (bottom - top) * 2
    level = (rgb * _LEVELS).long().clamp(0, _LEVELS - 1)
    color = (level[..., 0] * _LEVELS + level[..., 1]) * _LEVELS + level[..., 2]
    mask = inside & (across**2 + down**2 < _ELLIPSE)
    for _ in range(rounds):
        shares = []
        for part in (mask, ~inside):
            count = torch.bincount(color[part], minlength=_LEVELS**3).float().reshape(1, 1, *[_LEVELS] * 3)
            smooth = F.avg_pool3d(count, 3, 1, 1, count_include_pad=False).flatten()
            shares.append((smooth / smooth.sum() + 1e-4).log())
        score = (shares[0] - shares[1])[color][None, None]
        found = inside & (F.avg_pool2d(score, 5, 1, 2, count_include_pad=False)[0, 0] > 0)
        if not bool(found.any()):
            break
        mask = fill_holes(found, SMALL_HOLE)
    return resize(remove_specks(mask.float())[None], (image.shape[0], image.shape[1]))[0]


def transparency(image: Tensor) -> Tensor | None:
    """Return the alpha channel [H, W] of a picture [H, W, C], or None if there is none or it is opaque everywhere."""
    return image[..., 3] if image.shape[2] == 4 and float(image[..., 3].min()) < _CLEAR else None


def mask_beside(folder: Path, name: str) -> Path | None:
    """Find the mask of an image in a folder: ``photo.jpg`` has ``photo.png``, or ``photo.jpg.png`` as in COLMAP."""
    base = Path(name).name
    for stem in (base, Path(base).stem):
        for suffix in PICTURE_SUFFIXES:
            if (folder / (stem + suffix)).is_file():
                return folder / (stem + suffix)
    return folder / base if (folder / base).is_file() else None


def mask_in_file(path: Path, upright: bool = False) -> Tensor:
    """Read a mask [H, W] in [0, 1], see `as_mask`."""
    return as_mask(load_image(path, upright=upright))


def as_mask(image: Tensor) -> Tensor:
    """Return the alpha channel of a picture with transparent pixels, else its brightness: [H, W] in [0, 1]."""
    alpha = transparency(image)
    return image[..., :3].mean(2) if alpha is None else alpha
