"""Whole photographs: the object before the background that other views show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ...common.views.views import Views
from ..colors.texture import TextureFit

_SIZE, _STEPS = 3, 4  # texels along an edge, and steps of a texture that a comparison needs


@torch.no_grad()
def cut_out(views: Views, vertices: Tensor, faces: Tensor) -> Views:
    """Replace the masks and photos of views with backgrounds by cut-outs along the outlines of a mesh."""
    if views.backgrounds is None:
        return views
    alpha = torch.cat([views[[row]].silhouettes().draw((vertices, faces)).alpha for row in range(len(views))])
    return replace(views, masks=alpha, photos=views.cut_out(alpha))


def whole_error(views: Views, rows: Sequence[int], vertices: Tensor, faces: Tensor) -> float:
    """Measure how far a mesh before the background is from whole photographs: the mean absolute difference.

    Views number ``rows`` are measured; all others give the mesh its texture. Only pixels with a known background count;
    no mask is used.
    """
    if views.scenes is None or views.backgrounds is None:
        raise ValueError("views: expected scenes and backgrounds, got none")
    others = [row for row in range(len(views)) if row not in rows]
    fit = TextureFit(cut_out(views[others], vertices, faces), vertices, faces, size=_SIZE, steps=_STEPS)
    while not fit.done:
        fit.advance()
    shape, total = tuple(part.detach() for part in fit.shape), 0.0
    for row in rows:
        known, background = views.backgrounds[row].isfinite(), views.backgrounds[row].nan_to_num(0.0)
        with torch.no_grad():
            drawn = views[[row]].draw(shape, ("rgb", "alpha"))
        error = (drawn.rgb[0] + (1 - drawn.alpha[0]) * background - views.scenes[row]).abs()
        total += float((error * known).sum() / known.sum().clamp(min=1))
    return total / max(len(rows), 1)
