"""The first phase of a fit with cameras that are not exact: a coarse shape and the cameras, together."""

from __future__ import annotations

import math

from torch import Tensor

from ...settings import FitWeights
from ..detail.pyramid import reduced
from ..fit_views import Views
from ..hull import carve
from ..shape import ShapeFit
from .camera_refinement import CameraRefinement

_SIZE = 128  # pixels of the longer side of the images: the errors to mend are some pixels
_CELLS = 40  # of the grid of the hull, along each axis
_SMALLER = 4  # images have at most this part of the pixels, so that so many more views fit into a step
_MISSED = 1 / 8  # of the masks, in which a point of the hull need not lie
_LAPLACIAN = 30.0  # weight: the shape has to follow the cameras
_RATE, _CAMERA_RATE = 0.02, 0.01  # steps of vertices and cameras


def coarse_misses(views: Views) -> int:
    """Choose in how many masks a point of the hull need not lie."""
    return math.floor(_MISSED * len(views))


def coarse_hull(views: Views) -> tuple[Tensor, Tensor]:
    """Carve a coarse hull, of points that most of the masks contain."""
    return carve(views, _CELLS, coarse_misses(views))


def coarse_fit(
    views: Views,
    vertices: Tensor,
    faces: Tensor,
    cameras: CameraRefinement,
    *,
    steps: int,
    batch: int,
    gradient: str,
    seed: int,
) -> ShapeFit:
    """Make the fit of a coarse shape and of the cameras to small silhouettes.

    Args:
        views: Views that are `Views.normalized`.
        vertices, faces: The initial shape, [V, 3] and [F, 3].
        cameras: Their cameras, which the fit changes.
        steps: Number of steps if a step shows all views; more views take more.
        batch: Views per step of images of full size.
        gradient: Gradient estimator of the renderer, "edge" or "nmr".
        seed: Seed of the order of the views.
    """
    small = reduced(views, max(1, round(max(views.size) / _SIZE)))
    return ShapeFit(
        small,
        vertices,
        faces,
        steps=steps * math.ceil(len(views) / (_SMALLER * batch)),
        weights=FitWeights(laplacian=_LAPLACIAN),
        rate=_RATE,
        batch=_SMALLER * batch,
        gradient=gradient,
        seed=seed,
        cameras=cameras,
        camera_rate=_CAMERA_RATE,
    )
