"""`without_folds`: moves of vertices that turn no face over."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from ...common.geometry.edges import area_vectors

_HALVINGS = 6  # most halvings of a move that folds a face


def without_folds(before: Tensor, after: Tensor, faces: Tensor) -> Tensor:
    """Shorten the moves of vertices [V, 3] whose faces turn by more than a right angle."""
    old = functional.normalize(area_vectors(before[faces]).double(), dim=-1)
    for number in range(_HALVINGS + len(after)):
        turned = (area_vectors(after[faces]).double() * old).sum(1) < 0
        back = torch.zeros(len(after), dtype=torch.bool)
        back[faces[turned].reshape(-1)] = True
        back &= (after != before).any(1)
        if not bool(back.any()):
            break
        share = 0.5 if number < _HALVINGS else 0.0
        after = torch.where(back[:, None], before + share * (after - before), after)
    return after
