"""Chains of faces behind an outline, too narrow for a pixel to show them.

Bevels and rims are only parts of a pixel wide on the screen. An outline there belongs to a face that is rarely visible,
and so may be the next few faces of the surface. The visible part of the surface stands in for them.
"""

from __future__ import annotations

import torch
from torch import Tensor

LONGEST = 6  # faces of a chain behind the outline's own


def near_visible(visible: Tensor, links: Tensor) -> Tensor:
    """Mark visible faces, and the faces that are as near to one as a chain is long, less one.

    Args:
        visible: 1 for each visible face, [B, F + 1] int32, as from `visible_faces`.
        links: Linked faces of each face, [1 or B, F, 3]; -1 for none.

    Returns:
        [B, F + 1] int32.
    """
    batch, count = len(visible), visible.shape[1] - 1
    places = torch.where(links < 0, count, links).long().reshape(len(links), -1).expand(batch, -1)
    near = visible.clone()
    near[:, count] = 0  # stands for no face
    for _ in range(LONGEST - 1):
        linked = near.gather(1, places).view(batch, count, 3).amax(2)
        near[:, :count] = torch.maximum(near[:, :count], linked)
    return near
