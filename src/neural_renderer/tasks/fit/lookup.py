"""Values of masks at points of the world."""

from __future__ import annotations

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

from .fit_views import Views


def mask_values(views: Views, masks: Tensor, points: Tensor) -> Iterator[Tensor]:
    """Look up points in the masks of all views, one view after the other.

    Args:
        views: N views.
        masks: [N, H, W], any masks of their images.
        points: [P, 3] in the world.

    Yields:
        [P], interpolated; beside the image the value at its border, because the object may go on there; behind the
        camera 0.
    """
    aspect = views.size[1] / views.size[0]
    for index in range(len(views)):
        screen = views[index : index + 1].camera(points, aspect=aspect)[0]
        place = torch.stack((screen[:, 0], -screen[:, 1]), -1)[None, None]
        value = F.grid_sample(masks[index][None, None], place, padding_mode="border", align_corners=False)[0, 0, 0]
        yield torch.where(screen[:, 2] > 0, value, 0.0)
