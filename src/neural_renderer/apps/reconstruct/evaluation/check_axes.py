"""A check that the voxels of a data set have the axes that its images show."""

from __future__ import annotations

from itertools import permutations, product

import torch
import torch.nn.functional as F
from torch import Tensor

from ....optim.metrics import silhouette_iou
from ..data.arrays import Split
from ..data.framing import GRID, view_camera
from .sheets import evenly_spaced

_VIEWS = (1, 8, 15, 22)  # no two of them are mirror images of each other for symmetric objects
_MARGIN = 0.05  # other axes must fit better by this much


def check_axes(split: Split, name: str, most: int = 4) -> tuple[float, str | None]:
    """Compare the silhouettes of voxels and images, for all permutations and reversals of the voxels' axes.

    The IoU is computed at 32 pixels, from four views of each of up to ``most`` objects. Thin objects reach about 0.5,
    because voxels are coarse. Axes that are symmetries of the objects are indistinguishable. Returns the mean IoU; and
    the axes that fit clearly better, or None. "(2, 1, -0)": the last axis first, the first one reversed and last.
    """
    selected = evenly_spaced(len(split.images[name]), most)
    axes = list(product(permutations(range(3)), product((1, -1), repeat=3)))
    iou = torch.zeros(len(axes))
    for index in selected:
        voxels = torch.from_numpy(split.voxels[name][index].copy())
        alpha = torch.from_numpy(split.images[name][index][list(_VIEWS), 3].copy()).float() / 255
        masks = F.avg_pool2d(alpha[None], alpha.shape[-1] // GRID)[0] > 0.5
        centers = voxels.nonzero() - (GRID - 1) / 2
        permuted = [centers[:, order] * torch.tensor(sign) / (GRID - 1) for order, sign in axes]
        silhouettes = _silhouettes(torch.stack(permuted))
        iou += silhouette_iou(silhouettes.flatten(0, 1), masks.repeat(len(axes), 1, 1)).reshape(len(axes), -1).mean(1)
    iou /= len(selected)
    best = int(iou.argmax())
    if iou[best] <= iou[0] + _MARGIN:
        return float(iou[0]), None
    order, sign = axes[best]
    return float(iou[0]), "(" + ", ".join(f"{'-' * (s < 0)}{axis}" for axis, s in zip(order, sign, strict=True)) + ")"


def _silhouettes(centers: Tensor) -> Tensor:
    """Project the centres of voxels [W, N, 3], in the published axes, into four views: [W, 4, 32, 32] bool."""
    y, x, z = centers.unbind(-1)
    camera = view_camera(torch.tensor(_VIEWS))
    screen = camera(torch.stack((x, y, -z), -1).flatten(0, 1)).unflatten(1, centers.shape[:2])  # [4, W, N, 3]
    column, row = ((screen[..., axis] * sign + 1) / 2 * GRID for axis, sign in ((0, 1), (1, -1)))
    pixel = row.long().clamp(0, GRID - 1) * GRID + column.long().clamp(0, GRID - 1)
    covered = torch.zeros(*pixel.shape[:2], GRID * GRID, dtype=torch.bool)
    return covered.scatter_(2, pixel, True).transpose(0, 1).unflatten(2, (GRID, GRID))
