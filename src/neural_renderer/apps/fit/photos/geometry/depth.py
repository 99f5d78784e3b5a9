"""Depth of posed photographs: which views to compare, which depths to try, and on which of them views agree.

The depth of each view is swept twice: in small pictures among planes, as far apart as points of the scene reach, then
in larger ones around what was found. A depth counts where other views found the same point (Merrell et al., "Real-time
visibility-based fusion of depth maps", 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from .....camera import Camera
from ....common.views.views import Views, downscale, photos_of
from ..copies import Progress
from .sweep import rays_of, sweep

_PARTNERS = 4  # views that a view is compared with
_BEST_ANGLE = 12.0  # best angle between rays in degrees: depth is accurate, and windows still look alike
_MOST_PLANES, _AROUND = 192, 3  # hypotheses at first, and on each side of a depth that was found
_SHIFT = 0.75  # pixels between two hypotheses
_TAIL, _WIDER = 0.01, 1.15  # share of outliers among the nearest and farthest points; growth of the others' range
_CORRELATION = 0.5  # least correlation of windows
_TOLERANCE = 1.0  # largest difference of two views' depths, in pixels
_PARTS = (2, 1)  # sides of the pictures of each sweep, as parts of the full side
_LEAST_POINTS = 10  # least number of points that determine the depth range of a view
_LEAST_SUPPORT = 2  # other views that must have found a point for it to count
_SAMPLE = 2000  # points whose motion is measured


@dataclass(frozen=True)
class DepthMaps:
    """Depth of N views."""

    depth: Tensor  # [N, H, W], NaN where none is known
    support: Tensor  # [N, H, W] int64, number of other views that found the same point
    error: Tensor  # [N], relative error of depth, of one pixel in the views that it was compared with
    others: Tensor | None = None  # [N, H, W] bool, pixels that surely do not show the object; None if unknown


def find_depth(views: Views, points: Tensor, progress: Progress) -> DepthMaps | None:
    """Find the depth of N views with photos; points [P, 3] of structure from motion give its range.

    Returns None if a view shows too few points.
    """
    known = depth_of(views, points.to(views.masks))
    if known is None:
        return None
    partners, steps = choose_partners(views, known, points.to(views.masks)), len(_PARTS) * len(views)
    depths: list[Tensor] = []
    for level, part in enumerate(_PARTS):
        greys = torch.stack(
            [downscale(photo.mean(0, keepdim=True), max(views.size) // part)[0] for photo in photos_of(views)]
        )
        size, found, shifts = (greys.shape[1], greys.shape[2]), [], []
        for row in range(len(views)):
            progress("depth", level * len(views) + row, steps)
            if depths:
                base = F.interpolate(_median(depths[row])[None, None], size, mode="nearest")[0, 0]
                shift = shift_of(views, row, partners[row], base)
                factors = factors_around(shift)
            else:
                base, factors, shift = planes(views, row, partners[row], known[row], size)
            found.append(sweep(views, greys, row, partners[row], base, factors))
            shifts.append(shift)
        depths = [depth for depth, _ in found]
    progress("depth", steps, steps)
    return compare(views, found, shifts)


def factors_around(shift: float) -> Tensor:
    """Choose the multiples [D] of a known depth to try, for its `shift_of`."""
    return 1 + torch.arange(-_AROUND, _AROUND + 1) * _SHIFT / shift


def compare(views: Views, found: Sequence[tuple[Tensor, Tensor]], shifts: Sequence[float]) -> DepthMaps:
    """Compare the depth of N views, found by `sweep` with a `shift_of` each."""
    errors = [_TOLERANCE / shift for shift in shifts]
    raw = torch.stack([torch.where(score > _CORRELATION, depth, torch.nan) for depth, score in found])
    agreed = [_agree(views, raw, row, errors) for row in range(len(views))]
    depth, count = (torch.stack(parts) for parts in zip(*agreed, strict=True))
    return DepthMaps(depth, count, torch.tensor(errors))


def supported(maps: DepthMaps) -> Tensor:
    """Mark the pixels [N, H, W] whose depth enough views found."""
    return torch.isfinite(maps.depth) & (maps.support >= min(_LEAST_SUPPORT, len(maps.depth) - 1))


def confirmed_by(views: Views, maps: DepthMaps, row: int, chosen: Tensor) -> Tensor:
    """Mark the pixels [H, W] of a view whose depth enough of the ``chosen`` views [N] bool found, too."""
    raw = torch.where(chosen[:, None, None] & supported(maps), maps.depth, torch.nan)
    raw[row] = maps.depth[row]
    return _agree(views, raw, row, maps.error.tolist())[1] >= _LEAST_SUPPORT


def places_of(views: Views, maps: DepthMaps, row: int) -> Tensor:
    """Compute the points [H, W, 3] that the pixels of a view show."""
    eye, ray = rays_of(views.camera[row : row + 1], (maps.depth.shape[1], maps.depth.shape[2]))
    return eye + maps.depth[row][..., None] * ray


def pixels_of(camera: Camera, points: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """Find the pixels of N cameras that show points [P, 3].

    Returns their numbers in a picture [N, P], 0 outside; whether they are inside; and the depth of the points.
    """
    pixels, depth = camera.project(points.expand(len(camera), -1, -1), size)
    x, y = pixels.floor().long().unbind(2)
    inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < size[1]) & (y < size[0])
    return torch.where(inside, y * size[1] + x, 0), inside, depth


def planes(
    views: Views, row: int, partners: list[int], known: Tensor, size: tuple[int, int]
) -> tuple[Tensor, Tensor, float]:
    """Choose planes to try for a view with points at known depths [P], as `sweep` takes them; and their `shift_of`."""
    near, far = depth_range(known)
    middle = (near * far) ** 0.5
    base = torch.full(size, middle)
    shift = shift_of(views, row, partners, base)
    count = round(min(max(middle * (1 / near - 1 / far) * shift / _SHIFT, 2 * _AROUND + 1), _MOST_PLANES))
    return base, 1 / torch.linspace(1 / near, 1 / far, count) / middle, shift


def depth_range(known: Tensor) -> tuple[float, float]:
    """Choose the least and the greatest depth to try for a view with points at known depths [P]."""
    return float(known.nanquantile(_TAIL)) / _WIDER, float(known.nanquantile(1 - _TAIL)) * _WIDER


def choose_partners(views: Views, depth: Tensor, points: Tensor) -> list[list[int]]:
    """Choose the views to compare each view with: they show the same points, from about the best angle."""
    rays = F.normalize(points - views.eyes()[0][:, None], dim=2)
    shown, chosen = torch.isfinite(depth), []
    for row in range(len(views)):
        both = shown[row] & shown
        angle = torch.rad2deg((rays[row] * rays).sum(2).clamp(-1, 1).acos())
        mean = (angle * both).sum(1) / both.sum(1).clamp(min=1)
        fitness = both.float().mean(1) * torch.exp(-((mean + 1e-3) / _BEST_ANGLE).log().square())
        fitness[row] = -1.0
        chosen.append(fitness.topk(min(_PARTNERS, len(views) - 1)).indices.tolist())
    return chosen


def depth_of(views: Views, points: Tensor) -> Tensor | None:
    """Compute the depth [N, P] of points in the views, NaN outside of a picture; None if a view shows too few."""
    pixels, depth = views.camera.project(points, views.size)
    inside = (pixels > 0).all(-1) & (pixels < pixels.new_tensor([views.size[1], views.size[0]])).all(-1)
    known = torch.where(inside & (depth > 0), depth, torch.nan)
    return None if int(torch.isfinite(known).sum(1).min()) < _LEAST_POINTS else known


def shift_of(views: Views, row: int, partners: list[int], base: Tensor) -> float:
    """Measure the motion of a point in the partners' pictures, in pixels per small relative change of depth."""
    size = base.shape[0], base.shape[1]
    eye, ray = rays_of(views.camera[row : row + 1], size)
    known = torch.isfinite(base)
    if not bool(known.any()):
        return float(max(size))
    points = (base[..., None] * ray)[known][:: max(1, int(known.sum()) // _SAMPLE)]
    pixels = [
        views.camera[partners].project((eye + points * factor).expand(len(partners), -1, -1), size)[0]
        for factor in (1, 1 + 1e-3)
    ]
    return max(float((pixels[1] - pixels[0]).norm(dim=2).median()) / 1e-3, 1.0)


def _agree(views: Views, raw: Tensor, row: int, errors: Sequence[float]) -> tuple[Tensor, Tensor]:
    """Compare the depth of one view with the ``raw`` depth [N, H, W] of all views, which have relative ``errors``.

    Returns the mean depth [H, W] over the views that found the same point, and the number of others.
    """
    depth, size = raw[row], raw.shape[1:]
    eye, ray = rays_of(views.camera[row : row + 1], (size[0], size[1]))
    place = (eye + depth.nan_to_num(1.0)[..., None] * ray).reshape(1, -1, 3)
    pixels, far = views.camera.project(place.expand(len(views), -1, -1), size)
    grid = pixels / pixels.new_tensor([size[1], size[0]]) * 2 - 1
    other = F.grid_sample(raw[:, None], grid.view(-1, *size, 2), mode="nearest", align_corners=False)[:, 0]
    ratio = other / far.view_as(other)  # 0 outside of a picture
    error = torch.tensor(errors)[:, None, None].clamp(min=errors[row])
    agrees = ((ratio - 1).abs() < error).float()
    count = agrees.sum(0)  # with itself
    return depth * (ratio.nan_to_num(0.0) * agrees).sum(0) / count, (count - 1).long()


def _median(depth: Tensor) -> Tensor:
    """Replace each depth [H, W] by the median of those around it."""
    windows = F.pad(depth[None, None], (1, 1, 1, 1), mode="replicate")[0, 0].unfold(0, 3, 1).unfold(1, 3, 1)
    return windows.flatten(2).nanmedian(2).values
