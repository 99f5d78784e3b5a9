"""Structural similarity of pictures at several scales."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # of the scales, the finest first
_WINDOW, _SIGMA = 11, 1.5  # pixels
_LUMINANCE, _CONTRAST = 0.01**2, 0.03**2  # constants that keep the fractions finite, for values in [0, 1]
_GREY = (0.299, 0.587, 0.114)


def multi_scale_similarity(first: Tensor, second: Tensor, shown: Tensor) -> Tensor:
    """Compute the multi-scale structural similarity of pictures [B, 3, H, W] in [0, 1], in grey: [B].

    Wang, Simoncelli and Bovik, "Multi-scale structural similarity for image quality assessment" (2003), equation 7: the
    luminance of the coarsest scale times the contrast and structure of each, with their exponents. The means are over
    the windows around pixels [B, H, W] bool that are shown. Pictures that are too small have fewer scales, whose
    exponents are scaled to the same sum; NaN below 11². Equal pictures have 1, and so do empty ones.
    """
    grey = first.new_tensor(_GREY)[:, None, None]
    a, b = ((each.float() * grey).sum(1, keepdim=True) for each in (first, second))
    weight = shown[:, None].float()
    scales = sum(min(a.shape[2:]) >= _WINDOW * 2**scale for scale in range(len(_WEIGHTS)))
    if not scales:
        return torch.full((len(a),), torch.nan, dtype=torch.float64, device=a.device)
    exponents = torch.tensor(_WEIGHTS[:scales], dtype=torch.float64) / sum(_WEIGHTS[:scales])
    result = torch.ones(len(a), dtype=torch.float64, device=a.device)
    for scale in range(scales):
        mean_a, mean_b, squares, products = _blurred(torch.cat((a, b, a * a + b * b, a * b), 1)).split(1, 1)
        spread = squares - (mean_a**2 + mean_b**2)  # twice ``common``, to the bit, for equal pictures
        common = products - mean_a * mean_b
        value = (2 * common + _CONTRAST) / (spread + _CONTRAST)
        if scale + 1 == scales:
            value = value * (2 * mean_a * mean_b + _LUMINANCE) / (mean_a**2 + mean_b**2 + _LUMINANCE)
        border = _WINDOW // 2
        inner = (weight[:, :, border:-border, border:-border] > 0).double()
        mean = (value * inner).sum((1, 2, 3)) / inner.sum((1, 2, 3)).clamp(min=1)
        mean = torch.where(inner.sum((1, 2, 3)) > 0, mean, 1.0)
        result = result * mean.clamp(min=0) ** exponents[scale]
        a, b, weight = (functional.avg_pool2d(each, 2) for each in (a, b, weight))
    return result


def _blurred(picture: Tensor) -> Tensor:
    """Average the Gaussian windows that lie inside of pictures [B, C, H, W]."""
    place = torch.arange(_WINDOW, dtype=picture.dtype, device=picture.device) - _WINDOW // 2
    window = torch.exp(-place.square() / (2 * _SIGMA**2))
    channels = picture.shape[1]
    window = (window / window.sum()).repeat(channels, 1, 1, 1)
    return functional.conv2d(functional.conv2d(picture, window, groups=channels), window.mT, groups=channels)
