"""Cutting an object out of a picture, and framing it like the training data."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...components import connected_components
from ..data.framing import SIZE

EXTENT = 44  # mean length of the object's longer side in the training data, in pixels
_LOWER = 1.5  # mean distance of the object's centre below the image's centre in the training data, in pixels
_MOST_PIXELS = 2048  # larger pictures are scaled down: their details are lost at 64 pixels anyway
_MOST_SEARCHED = 640  # the background is fitted to a picture scaled down to this larger side in pixels
_SPECK = 0.02  # components smaller than this, relative to the largest one, are dropped
_LEAST_OBJECT = 8  # pixels

# A plain background: a quadratic function of position, fitted robustly to the border of the picture.
_BORDER = 0.02  # width of the border, relative to the shorter side
_BACKGROUND_SHARE = 0.65  # at least this share of the border is background; the rest may be object
_ITERATIONS = 8  # of fitting to the pixels that fit best so far
_LEAST_RESIDUAL = 0.02  # residuals below this always count as background
_LEAST_THRESHOLD, _NOISES = 0.06, 5  # the object's distance from the background: an absolute limit, and in noise levels
_MOST_THRESHOLD, _MOST_OUTSIDE = 0.25, 0.34  # a noisier background, or more border outside of it, is not plain
_SOFT_FROM, _SOFT_WIDTH = 0.6, 0.8  # alpha rises from 0 to 1 between 0.6 and 1.4 times the threshold


def cut_out(image: Tensor, mask: Tensor | None = None) -> Tensor:
    """Cut the object out of a picture. Pictures larger than 2048 pixels are scaled down; specks are dropped.

    Args:
        image: [H, W, 3 or 4] in [0, 1], as `load_image` returns it.
        mask: [H, W] in [0, 1], 1 on the object, of the same aspect ratio. Without it, the alpha channel is used; and
            without that, the difference from a plain background.

    Returns:
        [4, H, W] float32 in [0, 1], RGBA; colours are not multiplied by alpha.

    Raises:
        ValueError: The picture shows no object, only the object, or no plain background.
    """
    image = _limit_size(image, _MOST_PIXELS)
    rgb = image[..., :3].permute(2, 0, 1)
    height, width = rgb.shape[1:]
    if mask is not None:
        if abs(mask.shape[0] * width - mask.shape[1] * height) > 0.02 * width * mask.shape[0]:
            raise ValueError(
                f"mask: expected the shape of the image, {width} x {height}, got {mask.shape[1]} x {mask.shape[0]}"
            )
        alpha = _resize(mask[None], (height, width))[0]
    elif image.shape[2] == 4 and float(image[..., 3].min()) < 0.99:
        alpha = image[..., 3]
    else:
        small = _limit_size(image, _MOST_SEARCHED).permute(2, 0, 1)
        alpha = _resize(plain_background_mask(small[:3])[None], (height, width))[0]
    if float(alpha.max()) < 0.5:
        raise ValueError("expected an object, got a picture without one")
    if float(alpha.min()) > 0.5:
        raise ValueError("expected background around the object, got a mask that covers the whole picture")
    return torch.cat((rgb, remove_specks(alpha)[None]))


def frame_object(rgba: Tensor, extent: float = EXTENT) -> Tensor:
    """Scale and move a cut-out object to the size and place of objects in the training data.

    Args:
        rgba: [4, H, W] in [0, 1], as `cut_out` returns it.
        extent: Length of the object's longer side in pixels. In the training data it is 30 to 59, depending on the
            shape (see `predict.best_frame`).

    Returns:
        [4, 64, 64] uint8.

    Raises:
        ValueError: The object is smaller than 8 pixels.
    """
    rows, columns = (np.flatnonzero((rgba[3] > 0.5).any(axis).numpy()) for axis in (1, 0))
    if not len(rows):
        raise ValueError("expected an object, got a picture without one")
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    found = max(bottom - top, right - left)
    if found < _LEAST_OBJECT:
        raise ValueError(f"expected an object of at least {_LEAST_OBJECT} pixels, got one of {found}")
    side = found * SIZE / extent
    center = torch.tensor([(left + right) / 2, (top + bottom) / 2 - _LOWER * side / SIZE])
    # Colours are multiplied by alpha, so that the background does not bleed in. Shrinking first avoids aliasing.
    pixels = torch.cat((rgba[:3] * rgba[3:], rgba[3:]))
    scale = min(1.0, 2 * SIZE / float(side))
    size = [max(1, round(scale * n)) for n in pixels.shape[1:]]
    small = F.interpolate(pixels[None], size, mode="bilinear", antialias=scale < 1, align_corners=False)
    place = (torch.arange(2 * SIZE) + 0.5) / (2 * SIZE) - 0.5
    y, x = torch.meshgrid(place * side + center[1], place * side + center[0], indexing="ij")
    grid = torch.stack((2 * x / rgba.shape[2] - 1, 2 * y / rgba.shape[1] - 1), -1).float()
    sampled = F.grid_sample(small, grid[None], padding_mode="zeros", align_corners=False)
    pixels = F.avg_pool2d(sampled, 2)[0].clamp(0, 1)
    pixels = pixels * (pixels[3:] > 0.5 / 255)
    colors = (pixels[:3] / pixels[3:].clamp(min=1e-6)).clamp(0, 1)
    return (torch.cat((colors, pixels[3:])) * 255 + 0.5).to(torch.uint8)


def plain_background_mask(rgb: Tensor) -> Tensor:
    """Separate an object from a plain background, such as a wall or paper in uneven light.

    The background is a quadratic function of position, fitted to the border of the picture. Up to a third of the
    border may show the object.

    Args:
        rgb: [3, H, W] in [0, 1].

    Returns:
        [H, W] in [0, 1], 1 on the object, soft at its outline.

    Raises:
        ValueError: The background is not plain.
    """
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
    threshold = max(_LEAST_THRESHOLD, _NOISES * noise)
    if threshold > _MOST_THRESHOLD or float((error > threshold).float().mean()) > _MOST_OUTSIDE:
        raise ValueError("expected transparency, a mask, or a plain background, got a background of many colours")
    distance = (rgb - (basis @ coefficients).permute(2, 0, 1)).abs().amax(0)
    return ((distance - _SOFT_FROM * threshold) / (_SOFT_WIDTH * threshold)).clamp(0, 1)


def remove_specks(alpha: Tensor) -> Tensor:
    """Set the small connected components of a mask [H, W] to 0."""
    small = _limit_size(alpha[..., None], _MOST_SEARCHED)[..., 0]
    label = label_components(small > 0.5)
    count = torch.bincount(label[label >= 0])
    kept = torch.isin(label, (count >= _SPECK * count.max()).nonzero()[:, 0])
    wide = F.max_pool2d(kept[None, None].float(), 5, 1, 2)  # includes the soft outline
    return alpha * F.interpolate(wide, tuple(alpha.shape), mode="nearest")[0, 0]


def label_components(mask: Tensor) -> Tensor:
    """Label the connected components of a mask [H, W] bool: int64 [H, W], -1 outside of the mask."""
    height, width = mask.shape
    index = torch.arange(height * width).reshape(height, width)
    across, down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    horizontal = torch.stack((index[:, 1:][across], index[:, :-1][across]), 1)
    vertical = torch.stack((index[1:][down], index[:-1][down]), 1)
    label = connected_components(torch.cat((horizontal, vertical)), height * width)
    return torch.where(mask, label.reshape(height, width), -1)


def _limit_size(image: Tensor, most: int) -> Tensor:
    """Shrink an image [H, W, C] to at most ``most`` pixels a side; colours are weighted by alpha, if there is any."""
    height, width = image.shape[:2]
    scale = most / max(height, width)
    if scale >= 1:
        return image
    weighted = image if image.shape[2] < 4 else torch.cat((image[..., :3] * image[..., 3:], image[..., 3:]), 2)
    size = (max(1, round(scale * height)), max(1, round(scale * width)))
    small = _resize(weighted.permute(2, 0, 1), size).permute(1, 2, 0)
    if image.shape[2] < 4:
        return small
    return torch.cat((small[..., :3] / small[..., 3:].clamp(min=1e-6), small[..., 3:]), 2)


def _resize(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize an image [C, H, W]."""
    if tuple(image.shape[1:]) == size:
        return image
    return F.interpolate(image[None], size, mode="bilinear", antialias=True, align_corners=False)[0].clamp(0, 1)
