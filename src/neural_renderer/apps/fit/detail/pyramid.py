"""Views at lower resolutions, from coarse to fine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ...common.views.views import WHOLE, Views

_LEAST_SIZE = 64  # pixels of the longer side of reduced images
_COARSE_SIZE = 128  # the same, for errors of some pixels
_EDGE_PIXELS = 3.0  # least target length of edges
_FROM = (0.0, 0.2, 0.6)  # fraction of the steps after which a level counts


class Pyramid:
    """Views at a quarter, at half and at full resolution.

    Levels that would make the initial mesh, of the mean ``edge_length``, coarser are left out, and those whose longer
    side has fewer than ``least`` pixels.
    """

    def __init__(self, views: Views, edge_length: float, least: int = _LEAST_SIZE) -> None:
        self._levels = [views]
        for divisor in (2, 4):
            if max(views.size) >= divisor * least:
                level = reduced(views, divisor)
                if shortest_edge(level) <= edge_length:
                    self._levels.insert(0, level)

    def at(self, progress: float) -> Views:
        """Choose the level for a fraction of the steps, in [0, 1]."""
        begin = _FROM[-len(self._levels) :]
        return self._levels[max(sum(progress >= each for each in begin) - 1, 0)]


def reduced(views: Views, divisor: int) -> Views:
    """Reduce the resolution of views by averaging.

    Depth is the mean of known depths. Normals become unit vectors again, times the mask.
    """
    height, width = (max(1, round(side / divisor)) for side in views.size)

    def mean(images: Tensor) -> Tensor:
        return F.interpolate(images, (height, width), mode="area")

    masks = mean(views.masks[:, None])
    pictures = {name: getattr(views, name) for name in ("photos", "scenes", "backgrounds")}
    colors: dict[str, Any] = {name: mean(images) for name, images in pictures.items() if images is not None}
    normals = None if views.normals is None else F.normalize(mean(views.normals), dim=1) * masks
    depth = None
    if views.depth is not None:
        known = mean((views.depth > 0).to(views.depth)[:, None])
        # A pixel at a jump of depth has no depth.
        depth = torch.where(known > WHOLE, mean(views.depth[:, None]), 0.0)[:, 0]
    return replace(views, masks=masks[:, 0], normals=normals, depth=depth, **colors)


def coarse(views: Views) -> Views:
    """Reduce the resolution of views to about 128 pixels, which show errors of cameras by some pixels."""
    return reduced(views, max(1, round(max(views.size) / _COARSE_SIZE)))


def shortest_edge(views: Views) -> float:
    """Choose the least target length of edges: 3 pixels, where the object is about two units long."""
    inside = views.masks > 0.5
    rows, columns = inside.any(2).sum(1), inside.any(1).sum(1)
    return 2 * _EDGE_PIXELS / float(torch.maximum(rows, columns).float().median())
