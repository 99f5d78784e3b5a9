"""Views in which a face of a known mesh has another colour than in most: something stands before it, or it shines."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...common.views.views import WHOLE, Views, photos_of

_FEWEST = 3  # views of a face among which one can differ from most
_SPREAD = 1.4826  # standard deviation of normal errors, relative to the median of their sizes
_USUAL = 2.0  # standard deviations that are no outliers
_LEAST = 0.02  # differences of colours that are never outliers


@torch.no_grad()
def weigh_views(views: Views, vertices: Tensor, faces: Tensor) -> Tensor:
    """Compute how much each view counts for the colour of the face that a pixel shows, [N, H, W] in (0, 1].

    A view that shows a branch in front of a wall, or a highlight, has another mean colour there than the other views.
    With a difference d from the median of all views, its weight is (u / d)² beyond u, which is usual for this face, or
    for most faces where that is more. Waechter, Moehrle and Goesele, "Let There Be Color!" (ECCV 2014) leave such views
    out; a weight keeps what few views show. Pixels of no face have the weight 1.
    """
    means = vertices.new_full((len(views), len(faces), 3), torch.nan, dtype=torch.float16)
    shown = []  # the face at the middle of each pixel, [H, W]; -1 is the background
    for row in range(len(views)):
        part = views[row : row + 1]
        index = part.fragments((vertices, faces), anti_aliasing=False).face_index[0]
        inside = (index >= 0) & (part.masks[0] > WHOLE)
        colors = photos_of(part)[0].movedim(0, 2)[inside]
        colors = colors if part.gains is None else colors / part.gains[0]
        sums = vertices.new_zeros(len(faces), 4)
        sums.index_add_(0, index[inside].long(), F.pad(colors, (0, 1), value=1.0))
        means[row] = sums[:, :3] / sums[:, 3:]
        shown.append(index)
    median = means.nanmedian(0).values
    far = torch.stack([(each - median).float().norm(dim=1) for each in means])
    known = far.isfinite()
    known &= known.sum(0) >= _FEWEST
    if not bool(known.any()):
        return torch.ones_like(views.masks)
    spread = torch.where(known, far, torch.nan)
    usual = torch.maximum(spread.nanmedian(0).values.nan_to_num(), spread.nanmedian())
    usual = (_USUAL * _SPREAD * usual).clamp(min=_LEAST)
    weights = torch.where(known, (usual / far.clamp(min=_LEAST)).clamp(max=1).square(), 1.0)
    drawn = [
        torch.where(index >= 0, one[index.clamp(min=0).long()], 1.0) for one, index in zip(weights, shown, strict=True)
    ]
    return torch.stack(drawn)
