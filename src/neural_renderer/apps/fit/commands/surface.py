"""Open surface of posed photographs, for `neural-renderer fit`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ....camera.files import CameraFile
from ....meshes.mesh import Mesh
from ...common.command import progress_bars
from ...common.views.views import photos_of
from .. import FitResult, MaskRule, Views
from ..options import FitOptions
from ..photos.geometry.surface import find_surface
from ..photos.masks.shape_masks import points_by_depth

SURFACE_SIZE = 800
"""Longer side of the pictures in pixels."""
WHOLE = MaskRule(below=1e-6)
"""Rule that keeps the whole picture but black pixels."""
_FILE = "surface.ply"
_TAIL = 0.9  # quantile of distances that defines the size


def surface_of(options: FitOptions, cameras: CameraFile, views: Views, rows: Sequence[int]) -> tuple[Mesh, Views]:
    """Make a surface of some of the views, or read that of an interrupted run; return also all views, cut out to it.

    Raises ValueError if the photographs do not agree.
    """
    file, points = options.output / _FILE, cameras.points
    if points is None:
        with progress_bars() as report:
            points = points_by_depth(views, report)
    if not len(points):
        raise ValueError(f"{options.images}: expected photographs that agree on points for --surface, got none")
    points = points.to(views.masks)
    center = points.median(0).values
    scale = float((points - center).norm(dim=1).quantile(_TAIL))
    near = views.normalized(center, scale)
    if not (options.resume and file.is_file()):
        with progress_bars() as report:
            vertices, faces = find_surface(near[list(rows)], (points - center) / scale, report)
        Mesh(vertices * scale + center, faces).save(file)
    mesh = Mesh.load(file, texture_size=2)
    with torch.no_grad():
        shape = (mesh.vertices - center) / scale, mesh.faces
        alpha = torch.cat([near[row : row + 1].draw(shape).alpha for row in range(len(views))])
    return mesh, replace(views, masks=alpha, photos=photos_of(views) * alpha[:, None], region=(center, 2 * scale))


def on_surface(result: FitResult, fitted: Views, held_out: Views | None) -> FitResult:
    """Convert the figures of a result to the PSNR on pixels that the surface covers, and the share of these."""

    def covered(views: Views | None, figures: dict[str, Tensor] | None) -> dict[str, Tensor]:
        if views is None or figures is None:
            return {}
        share = views.masks.mean((1, 2))
        return {"psnr": figures["psnr"] + 10 * share.log10(), "covered": share}

    return replace(
        result,
        fitted=covered(fitted, result.fitted),
        held_out=covered(held_out, result.held_out),
        held_out_exposed=covered(held_out, result.held_out_exposed),
    )
