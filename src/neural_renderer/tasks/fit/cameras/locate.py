"""Cameras of further views of a fitted mesh, such as held-out ones."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ....losses import photometric, silhouette_iou_loss
from ..detail.pyramid import reduced
from ..fit_views import Views, photos_of
from .camera_refinement import CameraRefinement

_SIZE = 128  # pixels of the longer side of the images
_RATE = 0.01  # first step of a camera
_PHOTOMETRIC = 4.0  # weight of colours; that of silhouettes is 1


def locate_cameras(views: Views, shape: tuple[Tensor, ...], steps: int = 40) -> Views:
    """Refine the poses of views of a known mesh, which stays as it is.

    A fit with refined cameras says little about views whose cameras are as wrong as the others were. So they are
    located before the fit is measured on them, as in Lin et al., "BARF" (2021), section 4.

    Args:
        views: Views that are `Views.normalized`.
        shape: (vertices, faces) or (vertices, faces, textures).
        steps: Number of steps, ≥ 1.

    Returns:
        The views, with other cameras.

    Example:
        >>> from neural_renderer.tasks.fit import Views
        >>> from neural_renderer.tasks.fit.cameras.locate import locate_cameras
        >>> views = Views.of(mesh, camera, 32)
        >>> located = locate_cameras(views, (mesh.vertices, mesh.faces), steps=2)
    """
    colored = views.photos is not None and len(shape) == 3
    small = reduced(views, max(1, round(max(views.size) / _SIZE)))
    found = []
    for row in range(len(views)):
        view = small[[row]]
        refinement = CameraRefinement(view.camera, focal=False)
        best, camera = float("inf"), view.camera
        for step in range(steps):
            images = refinement.place(view, [0]).draw(shape, ("rgb", "alpha") if colored else "alpha")
            loss = silhouette_iou_loss(images.alpha, view.masks)
            if colored:
                loss = loss + _PHOTOMETRIC * photometric(images.rgb, photos_of(view), view.masks)
            if loss.item() < best:
                best, camera = loss.item(), refinement.camera
            gradients = torch.autograd.grad(loss, refinement.parameters)
            refinement.step(gradients, [0], _RATE * (1 - step / steps))
        found.append(camera)
    return replace(views, camera=type(views.camera).cat(found))
