"""Photo-consistency: what a surface shows in one view, it shows in the nearest other views."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ...common.views.views import WHOLE, Views, photos_of
from .pyramid import shortest_edge

_NEAREST = 2  # other views that each view is compared with
_WINDOW = 7  # side of the patches in pixels
_NOISE = 0.02  # standard deviation of colours up to which patches count as plain
_SHARED = 0.5  # least share of a patch that both views show


@torch.no_grad()
def mismatch(views: Views, rows: list[int], vertices: Tensor, faces: Tensor) -> float:
    """Measure how badly a surface takes the colours of some views to the nearest others, in [0, 2].

    It is the mean over the masks of 1 − c, where c is the normalised cross-correlation of the patches around a pixel
    and around the same point in the other view; 0 where the other view does not show the point.
    """
    directions = F.normalize(views.eyes()[0], dim=1)
    near = (directions @ directions.t()).fill_diagonal_(-2).topk(min(_NEAREST, len(views) - 1)).indices
    pairs = [views[[row, other]] for row in rows for other in near[row].tolist()]
    return sum(_mismatch(pair, vertices, faces) for pair in pairs) / max(len(pairs), 1)


def _mismatch(pair: Views, vertices: Tensor, faces: Tensor) -> float:
    """Compare the first of two views with the second."""
    drawn = pair.fragments((vertices, faces), anti_aliasing=False)
    depth = drawn.interpolate(((vertices - pair.eyes()[0][:, None]) * pair.eyes()[1][:, None]).sum(2, keepdim=True))
    points = pair.camera[1](drawn.interpolate(vertices)[0].flatten(0, 1), aspect=pair.size[1] / pair.size[0])
    screen = points.view(*pair.size, 3)
    grid = torch.stack((screen[..., 0], -screen[..., 1]), 2)[None]
    inside = (drawn.mask & (pair.masks > WHOLE)).float()
    known = F.grid_sample(torch.stack((depth[1, ..., 0], inside[1]))[None], grid, "nearest", align_corners=False)[0]
    close = (screen[..., 2] - known[0]).abs() < shortest_edge(pair)
    valid = (inside[0] * (known[1] > 0) * close)[None, None]
    other = F.grid_sample(photos_of(pair)[1:], grid, align_corners=False)
    share = _mean(valid).clamp(min=1e-6)
    found = correlation(photos_of(pair)[:1], other, _NOISE, lambda image: _mean(image * valid) / share)
    return 1 - float((found * valid[:, 0] * (share[:, 0] > _SHARED)).sum() / inside[0].sum().clamp(min=1))


def _mean(images: Tensor) -> Tensor:
    """Average images [N, C, H, W] over windows."""
    return F.avg_pool2d(images, _WINDOW, 1, _WINDOW // 2, count_include_pad=False)


def correlation(first: Tensor, second: Tensor, noise: float, mean: Callable[[Tensor], Tensor] = _mean) -> Tensor:
    """Compute the normalised cross-correlation [N, H, W] of the windows around each pixel of two images [N, C, H, W].

    ``noise`` is the standard deviation up to which windows count as plain; ``mean`` averages over windows.
    """
    middles = mean(first), mean(second)
    shared = (mean(first * second) - middles[0] * middles[1]).sum(1)
    spreads = [
        (mean(image.square()) - middle.square()).sum(1).clamp(min=0) + noise**2
        for image, middle in zip((first, second), middles, strict=True)
    ]
    return shared / (spreads[0] * spreads[1]).sqrt()
