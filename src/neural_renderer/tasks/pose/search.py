"""Global search: a known mesh is drawn from all sides, turned in the picture by correlation, and compared."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import rotations
from ...meshes.primitives import icosphere
from .model import Model, Poses
from .target import Crop

_TEMPLATE = 64  # side of a template in pixels
_RADII, _ANGLES = 20, 72  # of the polar grids
_REACH = 2.6  # outer radius of a polar grid, in root mean square distances of the silhouette from its centroid
_AT_ONCE = 256  # poses drawn together


def view_rotations(level: int) -> Tensor:
    """Make rotations [V, 3, 3] into a camera's space (x right, y down, z forward) from evenly spread directions."""
    forward, _ = icosphere(level)
    up = torch.where(forward[:, 1:2].abs() > 0.9, torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0]))
    right = F.normalize(torch.linalg.cross(forward, up), dim=1)
    return torch.stack((right, torch.linalg.cross(forward, right), forward), 1)


def moments(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Compute centroids [B, 2] in pixels, x and y, and root mean square distances from them [B], of [B, n, n]."""
    at = torch.arange(mask.shape[-1]) + 0.5
    area = mask.sum((1, 2)).clamp(min=1e-3)
    x, y = (mask.sum(1) * at).sum(1) / area, (mask.sum(2) * at).sum(1) / area
    xx, yy = (mask.sum(1) * at**2).sum(1) / area, (mask.sum(2) * at**2).sum(1) / area
    return torch.stack((x, y), 1), (xx + yy - x**2 - y**2).clamp(min=0.25).sqrt()


def _polar(mask: Tensor, center: Tensor, spread: Tensor) -> Tensor:
    """Sample silhouettes [B, n, n] around their centroids, [B, radii, angles]."""
    radius = (torch.arange(_RADII) + 0.5) / _RADII * _REACH
    angle = torch.arange(_ANGLES) * (2 * math.pi / _ANGLES)
    grid = torch.stack((radius[:, None] * angle.cos(), radius[:, None] * angle.sin()), -1)
    at = center[:, None, None] + spread[:, None, None, None] * grid
    return F.grid_sample(mask[:, None], at * (2 / mask.shape[-1]) - 1, align_corners=False)[:, 0]


def drawn_masks(model: Model, poses: Poses, crop: Crop, motion: Tensor) -> Tensor:
    """Draw silhouettes without anti-aliasing, [B, n, n]."""
    parts = [poses[i : i + _AT_ONCE] for i in range(0, len(poses), _AT_ONCE)]
    return torch.cat([model.fragments(p, crop, motion, False).face_index >= 0 for p in parts]).float()


def _rays(crop: Crop, at: Tensor) -> Tensor:
    """Convert pixels [B, 2] to x / z and y / z."""
    return (at - crop.K[:2, 2]) / crop.K[:2, :2].diagonal()


def search(model: Model, crop: Crop, count: int, level: int = 3) -> Poses:
    """Find poses whose silhouettes agree with the mask of a crop best.

    The silhouettes from all sides are compared in polar coordinates around their centroids, in units of their size. So
    a correlation of circles compares all rotations in the picture at once.
    """
    views = view_rotations(level)
    center, spread = moments(crop.mask[None])
    focal = float(crop.K[0, 0])
    depth = 0.55 * focal / float(spread)  # of an object of usual shape
    rays = _rays(crop, center)[0]
    for _ in range(2):
        depth = max(depth, 1.15)
        reach = _TEMPLATE / 2 * 0.95 * math.sqrt(depth**2 - 1)  # focal length at which the sphere of radius 1 fits
        K = torch.tensor([[reach, 0, _TEMPLATE / 2], [0, reach, _TEMPLATE / 2], [0, 0, 1.0]])
        blank = torch.ones(_TEMPLATE, _TEMPLATE)
        frame = Crop(K, None, blank, None, blank)
        some = views if _ else views[:: max(1, len(views) // 40)]
        place = torch.tensor([[0.0, 0, -math.log(depth)]]).expand(len(some), 3)
        drawn = drawn_masks(model, Poses(some, place, torch.zeros(len(some), 1)), frame, torch.eye(3, 4))
        centers, spreads = moments(drawn)
        depth *= float(spreads.mean()) / reach * focal / float(spread) if not _ else 1.0
    # Correlate: the picture at the angle a shows the template at a - turn.
    radius = (torch.arange(_RADII) + 0.5)[None, :, None]
    own = _polar(crop.mask[None], center, spread)
    theirs = _polar(drawn, centers, spreads)
    spectrum = torch.fft.rfft(own * radius) * torch.fft.rfft(theirs).conj()
    shared = torch.fft.irfft(spectrum, n=_ANGLES).sum(1)  # [V, angles]
    union = (own * radius).sum() + (theirs * radius).sum((1, 2))[:, None] - shared
    best = (shared / union).flatten().topk(min(count, shared.numel())).indices
    view, turn = best // _ANGLES, (best % _ANGLES) * (2 * math.pi / _ANGLES)
    rotation = _about_z(turn) @ views[view]
    size = spreads[view] / reach * focal / spread  # of the template over that of the picture
    shift = (centers[view] - _TEMPLATE / 2) / reach / size[:, None]
    off = torch.einsum("bij,bj->bi", _about_z(turn)[:, :2, :2], shift)
    place = torch.cat((rays - off, -(depth * size).log()[:, None]), 1)
    tilt = torch.linalg.cross(torch.tensor([0.0, 0, 1]), torch.cat((rays, torch.ones(1))))
    return Poses(rotations.from_axis_angle(tilt[None]) @ rotation, place, torch.zeros(len(place), 1))


def matched(model: Model, poses: Poses, crop: Crop, motion: Tensor) -> Poses:
    """Shift and scale poses so that the moments of their silhouettes are those of the mask."""
    center, spread = moments(crop.mask[None])
    centers, spreads = moments(drawn_masks(model, poses, crop, motion))
    shift = (center - centers) / crop.K[:2, :2].diagonal()
    return Poses(
        poses.rotation, torch.cat((poses.place[:, :2] + shift, poses.place[:, 2:] + (spread / spreads).log()[:, None]), 1), poses.zoom
    )


def _about_z(angle: Tensor) -> Tensor:
    return rotations.from_axis_angle(torch.stack((0 * angle, 0 * angle, angle), 1))


def apart(poses: Poses, count: int, least: float) -> list[int]:
    """Choose the first poses, from best to worst, whose rotations differ by at least this angle in radians."""
    kept: list[int] = []
    for row in range(len(poses)):
        trace = torch.einsum("bij,ij->b", poses.rotation[kept], poses.rotation[row])
        if not kept or float(trace.max()) < 1 + 2 * math.cos(least):
            kept.append(row)
        if len(kept) == count:
            break
    return kept
