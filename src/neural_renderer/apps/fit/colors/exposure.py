"""Exposure and white balance of photographs, one gain for each view and colour channel; and their vignetting."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ....meshes.normals import face_normals
from ...common.views.views import VIEWS_PER_PASS, WHOLE, Views, photos_of

_CELLS = 32  # patches along the longest side of the surface
_DARK = 0.02  # darker colours are noise; colours as close to white are clipped
_ITERATIONS = 12  # rounds of reweighted least squares
_EXACT = 0.01  # residual, in log units, below which weights do not grow
_PRIOR = 1e-5  # weight of the priors that gains are 1 and vignetting is 0, relative to the patches


@torch.no_grad()
def estimate_exposure(views: Views, vertices: Tensor, faces: Tensor) -> tuple[Tensor, float]:
    """Estimate gains [N, 3] > 0 of photographs of one object, and their vignetting, from its surface.

    The surface is divided into patches. The logarithm of the mean colour of a patch in a view is the sum of the patch's
    and of the view's, and of the vignetting times r², where r is the distance from the centre of the image, 1 at a
    corner. The sum of the absolute residuals over all patches and views is minimised by reweighted least squares, so
    that highlights and errors of the shape count little. The gains of all views have the geometric mean 1 in each
    channel, as only ratios of gains can be seen.
    """
    faces = faces.long()
    patches = _patches(vertices, faces)
    found = [
        _patch_colors(views[start : start + VIEWS_PER_PASS], vertices, faces, patches)
        for start in range(0, len(views), VIEWS_PER_PASS)
    ]
    means, weights = (torch.cat(parts).double() for parts in zip(*found, strict=True))
    usable = (means[..., :3].amin(2) > _DARK) & (means[..., :3].amax(2) < 1 - _DARK)
    weights = torch.where(usable, weights, 0.0)
    shared = (weights > 0).sum(0) > 1
    if not bool(shared.any()):
        return views.masks.new_ones(len(views), 3), 0.0
    means, weights = means[:, shared], weights[:, shared]
    values = torch.cat((means[..., :3].clamp(min=_DARK).log(), means[..., 3:]), 2)
    robust = weights
    for _ in range(_ITERATIONS):
        # r² is a fourth channel: the part that views and patches explain is confounded with exposure.
        gains = _solve(values, robust)
        residual = values - gains[:, None]
        residual = residual - (robust[..., None] * residual).sum(0) / robust.sum(0)[:, None]
        colors, radial = residual[..., :3], residual[..., 3:]
        each = robust[..., None]
        slope = (each * radial * colors).mean() / (each * (radial.square() + _PRIOR)).mean()
        robust = weights / (colors - slope * radial).norm(dim=2).clamp(min=_EXACT)
    return (gains[:, :3] - slope * gains[:, 3:]).exp().to(views.masks), float(slope)


def without_vignetting(views: Views, vignetting: float) -> Views:
    """Divide the photos of views by their vignetting, as from `estimate_exposure`."""
    if not vignetting:
        return views
    brighter = torch.exp(-vignetting * _square_radius(views))
    pictures = {"photos": photos_of(views), "scenes": views.scenes, "backgrounds": views.backgrounds}
    flat: dict[str, Any] = {name: images * brighter for name, images in pictures.items() if images is not None}
    return replace(views, **flat)


def _square_radius(views: Views) -> Tensor:
    """Compute the squared distance of pixels from the centre of the image, [H, W]: 1 at a corner."""
    height, width = views.size
    y, x = (torch.arange(side).to(views.masks) - (side - 1) / 2 for side in (height, width))
    return (y[:, None].square() + x.square()) * (4 / (height**2 + width**2))


@torch.no_grad()
def match_gains(views: Views, shape: tuple[Tensor, ...]) -> Views:
    """Fit the gains of further views, such as held-out ones, to a known mesh.

    They are those of least squares over the pixels. The shape is (vertices, faces, textures), in the world of the
    views.
    """
    gains = []
    for start in range(0, len(views), VIEWS_PER_PASS):
        part = replace(views[start : start + VIEWS_PER_PASS], gains=None)
        rgb = part.draw(shape, "rgb").rgb
        both = (rgb * photos_of(part)).sum((2, 3))
        gains.append(torch.where(both > 0, both / rgb.square().sum((2, 3)).clamp(min=1e-6), 1.0))
    return replace(views, gains=torch.cat(gains))


def _patches(vertices: Tensor, faces: Tensor) -> Tensor:
    """Divide a surface into patches by place and direction: the patch of each face, [F] from 0 on."""
    centers, normals = vertices[faces].mean(1), face_normals(vertices[faces])
    low, high = vertices.amin(0), vertices.amax(0)
    cells = ((centers - low) / (high - low).amax() * _CELLS).long()
    side = (normals > 0).long()  # keeps the two sides of a sheet apart
    key = ((cells[:, 0] * 2 * _CELLS + cells[:, 1]) * 2 * _CELLS + cells[:, 2]) * 8 + side @ side.new_tensor([4, 2, 1])
    return torch.unique(key, return_inverse=True)[1]


def _patch_colors(views: Views, vertices: Tensor, faces: Tensor, patches: Tensor) -> tuple[Tensor, Tensor]:
    """Average colours, and the squared radius, of each patch in each view: [N, P, 4] and weights [N, P]."""
    index = views.fragments((vertices, faces), anti_aliasing=False).face_index.long()
    eyes, forward = views.eyes()
    corners = vertices[faces]
    rays = eyes[:, None] - corners.mean(1) if views.camera.perspective else -forward[:, None].expand(-1, len(faces), -1)
    cosines = (F.normalize(rays, dim=2) * face_normals(corners)).sum(2).square()
    inside = (-F.max_pool2d(-views.masks, 3, 1, 1) > WHOLE) & (index >= 0)
    rows, count = torch.arange(len(views), device=index.device)[:, None, None], int(patches.max()) + 1
    shown = index.clamp(min=0)
    place = (patches[shown] + count * rows)[inside]
    weight = cosines[rows.expand_as(shown), shown][inside][:, None]
    radius = _square_radius(views).expand_as(views.masks)[..., None]
    values = torch.cat((photos_of(views).movedim(1, 3), radius), 3)[inside]
    values = torch.cat((values * weight, weight), 1)
    total = values.new_zeros(len(views) * count, 5).index_add_(0, place, values).view(len(views), count, 5)
    return total[..., :4] / total[..., 4:].clamp(min=1e-6), total[..., 4]


def _solve(values: Tensor, weights: Tensor) -> Tensor:
    """Solve for gains [N, C], of mean 0, in values [N, P, C] = gains + patches with weights [N, P]."""
    share = weights / weights.sum(0)
    count, total = len(weights), weights.sum(1)
    matrix = torch.diag(total * (1 + _PRIOR) + 1e-9) - weights @ share.t() + total.mean() / count
    gains = torch.linalg.solve(matrix, (weights[..., None] * (values - (share[..., None] * values).sum(0))).sum(1))
    return gains - gains.mean(0)
