"""Warnings about views that can be fitted, but with a probably poor result."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from torch import Tensor

from ..common.views.views import Views, photos_of, view_center
from .agreement import hull_coverage
from .detail.whole import cut_out

ONE_SIDE = 40.0
"""Degrees between each camera and the mean one, seen from the object, below which all are on one side."""
SECOND = 0.2
"""Size of a second piece, relative to the first, above which it counts as an object."""
_COVERED = 0.9  # mean share of each mask that the hull fills, below which masks have holes or lack parts
_CUT, _OFTEN = 0.1, 1 / 3  # share of an outline that is the border of its image; share of such images: a doubt
_MATT = 0.3  # share of the variance of colours that a texture keeps, below which photographs disagree
_NOISE = 0.02**2  # variance of noise
_INSIDE = 0.99  # mask value above which a pixel shows only the object


def doubts(views: Views) -> dict[str, str]:
    """Describe problems of the views of an object, and remedies.

    Args:
        views: Views whose masks and cameras agree roughly.

    Returns:
        Sentences by problem: "one side", "two objects", "cut off" or "masks"; empty if there is none.

    Example:
        >>> from neural_renderer.apps.fit.doubts import doubts
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 10.0)
        >>> doubts(Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32))
        {'one side': 'all cameras are on one side, ...'}
    """
    found = {}
    if len(views) > 2 and cameras_apart(views) < ONE_SIDE:
        found["one side"] = (
            f"all cameras are on one side, within {cameras_apart(views):.0f}° of their mean: the back is guessed. "
            "Walk around the object, or make an open surface of what is seen"
        )
    if float(torch.tensor([_second_piece(mask) > SECOND for mask in views.masks]).float().mean()) > 0.5:
        found["two objects"] = "the masks show two objects: take one away, or out of the masks"
    cut = sum(_on_border(mask) > _CUT for mask in views.masks)
    if cut > _OFTEN * len(views):
        found["cut off"] = (
            f"{cut} of {len(views)} images cut the object off: parts that few images show whole may be missing. "
            "Step back, so that all of it is in each picture"
        )
    covered = float(hull_coverage(views).mean()) if len(views) > 2 else 1.0
    if covered < _COVERED:
        found["masks"] = (
            f"the masks do not agree: what all of them show fills {covered:.0%} of each, so parts will be missing. "
            "The background may have colours of the object, or its shadow: correct them by hand"
        )
    return found


@torch.no_grad()
def doubt_colors(views: Views, shape: tuple[Tensor, ...]) -> str | None:
    """Describe the disagreement of photos about the colours of a shape (vertices, faces, textures); None without.

    Where backgrounds are known, photos count within the outlines of the shape, as their masks may hold more than it.
    """
    kept = _explained(cut_out(views, shape[0], shape[1]), shape)
    if kept > _MATT:
        return None
    return (
        f"photographs disagree about the colours of the object: a texture keeps {max(kept, 0):.0%} of their variation; "
        "it may shine, be transparent, or have moved. Even light, and powder on it, help"
    )


def _explained(views: Views, shape: tuple[Tensor, ...]) -> float:
    """Measure the share of the variance of colours inside of the outlines that a shape explains; 1 without any."""
    left, all_of_it = 0.0, 0.0
    for row in range(len(views)):
        view = views[row : row + 1]
        drawn, photo = view.draw(shape, "rgb").rgb, photos_of(view)
        inside = -F.max_pool2d(-view.masks, 5, 1, 2)[0] > _INSIDE
        colors = photo[0][:, inside]
        left += float((colors - drawn[0][:, inside]).square().sum())
        all_of_it += float((colors - colors.mean(1, keepdim=True)).square().clamp(min=_NOISE).sum())
    return 1 - left / all_of_it if all_of_it else 1.0


def cameras_apart(views: Views) -> float:
    """Measure the largest angle at the object between a camera and the mean direction of all, in degrees."""
    center = view_center(views)[0] if views.region is None else views.region[0]
    directions = F.normalize(views.eyes()[0] - center, dim=1)
    return float(torch.rad2deg((directions @ F.normalize(directions.mean(0), dim=0)).clamp(-1, 1).acos().max()))


def _on_border(mask: Tensor) -> float:
    """Measure the share of the outline of a mask [H, W] that lies along the border of its image."""
    inside = (mask > 0.5).cpu().numpy()
    outline = inside & ~ndimage.binary_erosion(inside)
    border = ~ndimage.binary_erosion(np.ones_like(inside))
    return float((outline & border).sum() / max(outline.sum(), 1))


def _second_piece(mask: Tensor) -> float:
    """Measure the second largest piece of a mask [H, W], relative to the largest."""
    label, count = ndimage.label(mask.cpu().numpy() > 0.5)
    if count < 2:
        return 0.0
    sizes = sorted(ndimage.sum_labels(label > 0, label, range(1, count + 1)))
    return float(sizes[-2] / sizes[-1])
