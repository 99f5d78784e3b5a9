"""The first phase of a fit with cameras that are not exact: a coarse shape and the cameras, together."""

from __future__ import annotations

import math
from dataclasses import replace

from torch import Tensor

from ...settings import FitWeights
from ..detail.pyramid import reduced
from ..fit_views import Views
from ..hull import carve
from ..settings import DescentSettings
from ..shape import ShapeFit
from .camera_refinement import CameraRefinement

_SIZE = 128  # pixels of the longer side of the images: the errors to mend are some pixels
_CELLS = 40  # cells of the hull's grid along each axis
_SMALLER = 4  # times as many views fit into a step, because images have at most this part of the pixels
_MISSED = 1 / 8  # fraction of masks that a hull point may fall outside of
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
    steps: int,
    descent: DescentSettings,
) -> ShapeFit:
    """Make the fit of a coarse shape and of the cameras to small silhouettes.

    Args:
        views: Views that are `Views.normalized`.
        vertices, faces: The initial shape, [V, 3] and [F, 3].
        cameras: Their cameras, which the fit changes.
        steps: Number of steps if a step shows all views; more views take more.
        descent: Settings of gradient descent; the batch is that of images of full size.
    """
    small, batch = reduced(views, max(1, round(max(views.size) / _SIZE))), _SMALLER * descent.batch
    return ShapeFit(
        small,
        vertices,
        faces,
        steps=steps * math.ceil(len(views) / batch),
        weights=FitWeights(laplacian=_LAPLACIAN),
        rate=_RATE,
        descent=replace(descent, batch=batch),
        cameras=cameras,
        camera_rate=_CAMERA_RATE,
    )
