"""Photo-consistency: what a surface shows in one view, it shows in the nearest other views."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..fit_views import Views, photos_of
from .pyramid import shortest_edge

_NEAREST = 2  # other views that each view is compared with
_WINDOW = 7  # side of the patches in pixels
_NOISE = 0.02  # standard deviation of colours up to which patches count as plain
_INSIDE = 0.999  # least mask of pixels that count
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
    seen = pair.fragments((vertices, faces), anti_aliasing=False)
    depth = seen.interpolate(((vertices - pair.eyes()[0][:, None]) * pair.eyes()[1][:, None]).sum(2, keepdim=True))
    points = pair.camera[1](seen.interpolate(vertices)[0].flatten(0, 1), aspect=pair.size[1] / pair.size[0])
    screen = points.view(*pair.size, 3)
    grid = torch.stack((screen[..., 0], -screen[..., 1]), 2)[None]
    inside = (seen.mask & (pair.masks > _INSIDE)).float()
    known = F.grid_sample(torch.stack((depth[1, ..., 0], inside[1]))[None], grid, "nearest", align_corners=False)[0]
    close = (screen[..., 2] - known[0]).abs() < shortest_edge(pair)
    valid = (inside[0] * (known[1] > 0) * close)[None, None]
    other = F.grid_sample(photos_of(pair)[1:], grid, align_corners=False)
    both = torch.cat((photos_of(pair)[:1], other), 1) * valid
    share = _mean(valid).clamp(min=1e-6)
    mean = _mean(both) / share
    squares = _mean(torch.cat((both * both, both[:, :3] * both[:, 3:]), 1)) / share
    a, b, ab = (squares - torch.cat((mean * mean, mean[:, :3] * mean[:, 3:]), 1))[0].unflatten(0, (3, 3)).sum(1)
    correlation = ab / ((a.clamp(min=0) + _NOISE**2) * (b.clamp(min=0) + _NOISE**2)).sqrt()
    return 1 - float((correlation * valid * (share > _SHARED)).sum() / inside[0].sum().clamp(min=1))


def _mean(images: Tensor) -> Tensor:
    """Average images over windows."""
    return F.avg_pool2d(images, _WINDOW, 1, _WINDOW // 2)
