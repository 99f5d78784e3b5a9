"""Visual hull on a grid as fine as the holes and gaps that outlines show."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..fit_views import Views
from .space_carving import blur_radius, carve

LEVELS = (64, 96, 128)  # cells along each axis; the finest has 2 million points
_VIEWS_AT_ONCE = 8  # drawn together: limits memory
_LEAST = 4.0  # covered pixels that count in a view, in units of the squared radius of the coarsest blur
_LEAST_VIEWS = 2
_BETTER = 0.5  # a finer level must leave at most this part of the pixels that the one before covered


def carve_levels(views: Views, levels: tuple[int, ...] = LEVELS) -> tuple[Tensor, Tensor]:
    """Carve the visual hull on the coarsest grid that opens the holes and gaps of the masks.

    A hull lies inside all silhouettes. Where it covers background deeper than its blurred border is wide, its grid is
    too coarse. If several views show that, the hull is carved again at the next level, which is kept if it covers at
    most half as much.

    Args:
        views: Views that are `Views.normalized` to the object's bounds.
        levels: Numbers of grid cells along each axis, in ascending order.

    Returns:
        Vertices [V, 3] float32 and faces [F, 3] int64, as `carve`.

    Raises:
        ValueError: As `carve`.
    """
    margin = blur_radius(views, levels[0])
    shape = carve(views, levels[0])
    covered = covered_background(views, shape, margin)
    for cells in levels[1:]:
        counts = covered > _LEAST * margin**2
        if int(counts.sum()) < min(_LEAST_VIEWS, len(views)):
            break
        finer = carve(views, cells)
        left = covered_background(views, finer, margin)
        if float(left.sum()) > _BETTER * float(covered.sum()):
            break
        shape, covered = finer, left
    return shape


@torch.no_grad()
def covered_background(views: Views, shape: tuple[Tensor, Tensor], margin: int) -> Tensor:
    """Count the background pixels that a mesh covers, but those at its outline.

    Args:
        views: N views.
        shape: Vertices [V, 3] and faces [F, 3].
        margin: Pixels nearer to the mesh's outline than this are left out.

    Returns:
        [N] int64, pixels of each view.
    """
    found = []
    for start in range(0, len(views), _VIEWS_AT_ONCE):
        part = views[start : start + _VIEWS_AT_ONCE]
        outside = (part.draw(shape).alpha < 0.5).float()
        outside = F.max_pool2d(outside[:, None], 2 * margin + 1, 1, margin)[:, 0] > 0.5
        found.append((~outside & (part.masks < 0.5)).sum((1, 2)))
    return torch.cat(found)
