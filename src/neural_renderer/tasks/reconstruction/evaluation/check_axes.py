"""Whether the voxels of a folder of data stand as its images show them."""

from __future__ import annotations

from itertools import permutations, product

import torch
import torch.nn.functional as F
from torch import Tensor

from ....metrics import silhouette_iou
from ..data.arrays import Split
from ..data.framing import GRID, view_camera
from .sheets import spread

_VIEWS = (1, 8, 15, 22)  # none that shows a symmetric object the same from two sides
_CLEARLY = 0.05


def agreement(split: Split, name: str, most: int = 4) -> tuple[float, str | None]:
    """How well the voxels' outlines and the images' agree, and which other axes would fit clearly better, if any do.

    The IoU, at 32 pixels, of some objects of a class, each from four views: voxels are coarse, so that thin objects
    reach 0.5. Compared are all ways to exchange and to turn round the three axes of the voxels; the second value is
    like "(2, 1, -0)": the last axis first, the first one turned round and last. A class of objects that look alike
    both ways tells nothing of them.
    """
    chosen = spread(len(split.images[name]), most)
    ways = list(product(permutations(range(3)), product((1, -1), repeat=3)))
    fit = torch.zeros(len(ways))
    for index in chosen:
        solid = torch.from_numpy(split.voxels[name][index].copy())
        alpha = torch.from_numpy(split.images[name][index][list(_VIEWS), 3].copy()).float() / 255
        masks = F.avg_pool2d(alpha[None], alpha.shape[-1] // GRID)[0] > 0.5
        places = solid.nonzero() - (GRID - 1) / 2
        turned = [places[:, order] * torch.tensor(sign) / (GRID - 1) for order, sign in ways]
        outlines = _outlines(torch.stack(turned))
        fit += silhouette_iou(outlines.flatten(0, 1), masks.repeat(len(ways), 1, 1)).reshape(len(ways), -1).mean(1)
    fit /= len(chosen)
    best = int(fit.argmax())
    if fit[best] <= fit[0] + _CLEARLY:
        return float(fit[0]), None
    order, sign = ways[best]
    return float(fit[0]), "(" + ", ".join(f"{'-' * (s < 0)}{axis}" for axis, s in zip(order, sign, strict=True)) + ")"


def _outlines(places: Tensor) -> Tensor:
    """What voxels at ``places`` [W, N, 3], by the published axes, hide of each view: [W, 4, 32, 32] bool."""
    y, x, z = places.unbind(-1)
    camera = view_camera(torch.tensor(_VIEWS))
    seen = camera(torch.stack((x, y, -z), -1).flatten(0, 1)).unflatten(1, places.shape[:2])  # [4, W, N, 3]
    column, row = ((seen[..., axis] * sign + 1) / 2 * GRID for axis, sign in ((0, 1), (1, -1)))
    pixel = row.long().clamp(0, GRID - 1) * GRID + column.long().clamp(0, GRID - 1)
    outlines = torch.zeros(*pixel.shape[:2], GRID * GRID, dtype=torch.bool)
    return outlines.scatter_(2, pixel, True).transpose(0, 1).unflatten(2, (GRID, GRID))
