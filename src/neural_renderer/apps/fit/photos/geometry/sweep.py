"""Depth of posed photographs by plane sweeping: the depth at which a pixel's surroundings look alike in several views.

Collins, "A space-sweep approach to true multi-image matching" (1996); smoothed along lines of pixels after
Hirschmüller, "Stereo processing by semiglobal matching" (2008). Hypotheses are multiples of a depth for each pixel: of
a plane at first, then of the surface that was found, so that windows lean as it does.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from .....camera import Camera
from ....common.views.views import Views
from ...detail.consistency import correlation

_NOISE = 2.0 / 255  # standard deviation of grey values that says nothing
_BEST = 2  # partners that count at each depth, because others may see something in front
_STEP, _JUMP = 0.06, 0.35  # costs of a difference of one and of more hypotheses between neighbours
_EDGE = 0.04  # difference of grey values that halves the cost of a jump
_UNSEEN = -0.2  # correlation with a picture that does not show the point
_STRAIGHT = 1e-6  # second difference of costs below which they have no minimum


def sweep(
    views: Views, greys: Tensor, row: int, partners: Sequence[int], base: Tensor, factors: Tensor
) -> tuple[Tensor, Tensor]:
    """Find the depth of view ``row`` among multiples of a base depth at each pixel.

    The view is compared with the views ``partners``, by grey values [N, H, W]. The base [H, W] > 0 is NaN where no
    depth is known; factors [D] ascend. Returns the depth, NaN where there is none, and the correlation [H, W] of the
    windows, at most 1.
    """
    others = list(partners)
    size = base.shape
    eye, ray = rays_of(views.camera[row : row + 1], (size[0], size[1]))
    place = base.nan_to_num(1.0)[..., None] * ray
    grey = greys[row][None, None]
    camera = views.camera[others]
    scores = []
    for factor in factors:
        pixels, depth = camera.project((eye + factor * place).reshape(1, -1, 3).expand(len(others), -1, -1), size)
        grid = pixels / pixels.new_tensor([size[1], size[0]]) * 2 - 1
        seen = F.grid_sample(greys[others][:, None], grid.view(-1, *size, 2), align_corners=False)
        inside = (depth > 0) & (grid.abs() < 1).all(-1)
        score = correlation(grey, seen, _NOISE)
        score = torch.where(inside.view_as(score), score, _UNSEEN)
        scores.append(score.topk(min(_BEST, len(others)), 0).values.mean(0))
    volume = torch.stack(scores)
    total = _smoothed(1 - volume, greys[row])
    index = total.argmin(0)
    low, high = (index - 1).clamp(min=0), (index + 1).clamp(max=len(factors) - 1)
    before, here, after = (total.gather(0, place[None])[0] for place in (low, index, high))
    bend = before + after - 2 * here
    part = torch.where((low < index) & (index < high) & (bend > _STRAIGHT), (before - after) / (2 * bend), 0.0)
    part = part.clamp(-0.5, 0.5)
    side = torch.where(part > 0, high, low)
    factor = factors[index] + part.abs() * (factors[side] - factors[index])
    return base * factor, volume.gather(0, index[None])[0]


def rays_of(camera: Camera, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Compute the eye [3] of one camera, and for each pixel the ray [H, W, 3] from the eye to the depth 1."""
    y, x = torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")
    pixels = torch.stack((x, y), -1).view(-1, 2)
    near, far = (camera.unproject(pixels, torch.full((len(pixels),), float(depth)), size)[0] for depth in (1, 2))
    return (2 * near - far)[0], (far - near).view(*size, 3)


def _smoothed(cost: Tensor, grey: Tensor) -> Tensor:
    """Add up costs [D, H, W] along lines of pixels in four directions; jumps cost less at edges of the picture."""
    total = torch.zeros_like(cost)
    for axis in (1, 2):
        values, guide = cost.movedim(axis, 0), grey.movedim(axis - 1, 0)
        jumps = _JUMP / (1 + (guide[1:] - guide[:-1]).abs() / _EDGE)
        for order in (range(len(values)), range(len(values) - 1, -1, -1)):
            sums = total.movedim(axis, 0)
            before, last = values[order[0]], order[0]
            sums[last] += before
            for line in order[1:]:
                least = before.amin(0)
                near = F.pad(before, (0, 0, 1, 1), value=torch.inf)
                reach = torch.minimum(torch.minimum(near[:-2], near[2:]) + _STEP, before)
                reach = torch.minimum(reach, least + jumps[min(line, last)])
                before, last = values[line] + reach - least, line
                sums[line] += before
    return total
