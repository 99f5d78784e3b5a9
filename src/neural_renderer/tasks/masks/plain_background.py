"""Plain backgrounds, such as a wall or paper in uneven light."""

from __future__ import annotations

import torch
from torch import Tensor

from .operations import limit_size, resize

_MOST_SEARCHED = 640  # the background is fitted to a picture scaled down to this larger side in pixels

# A plain background: a quadratic function of position, fitted robustly to the border of the picture.
_BORDER = 0.02  # width of the border, relative to the shorter side
_BACKGROUND_SHARE = 0.65  # least share of background in the border; the rest may be object
_ITERATIONS = 8  # fits to the pixels that fit best so far
_LEAST_RESIDUAL = 0.02  # residuals below this always count as background
_LEAST_THRESHOLD, _NOISES = 0.06, 5  # the object's distance from the background: an absolute limit, and in noise levels
_MOST_THRESHOLD, _MOST_OUTSIDE = 0.25, 0.34  # a noisier background, or more border outside of it, is not plain
_SOFT_FROM, _SOFT_WIDTH = 0.6, 0.8  # alpha rises from 0 to 1 between 0.6 and 1.4 times the threshold


def plain_background_mask(image: Tensor) -> Tensor:
    """Separate an object from a plain background, such as a wall or paper in uneven light.

    The background is a quadratic function of position, fitted to the border of the picture [H, W, 3 or 4], whose alpha
    is ignored. Up to a third of the border may show the object.

    Returns:
        [H, W] in [0, 1], 1 on the object, soft at its outline.

    Raises:
        ValueError: The background is not plain.
    """
    rgb = limit_size(image[..., :3], _MOST_SEARCHED).permute(2, 0, 1)
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
    alpha = ((distance - _SOFT_FROM * threshold) / (_SOFT_WIDTH * threshold)).clamp(0, 1)
    return resize(alpha[None], (image.shape[0], image.shape[1]))[0]
