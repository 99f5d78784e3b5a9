"""What a fit leaves in its folder: pictures to look at, and numbers."""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from ...io import save_animation
from ...meshes.mesh import Mesh
from ...pictures.clay import CLAY
from ...pictures.photograph import photograph
from .fit_views import Views
from .mesh import with_texture


@torch.no_grad()
def comparison(views: Views, shape: tuple[Tensor, ...], columns: int = 6) -> Tensor:
    """Targets, results and differences of some views, one below the other: [3, 3H, columns · W] on white.

    Differences are white where there are none and red where the result has too much, blue where it lacks something;
    with colours, grey as dark as the colours differ.
    """
    rows = sorted({round(i * (len(views) - 1) / max(columns - 1, 1)) for i in range(columns)})
    some = views[rows]
    photos = some.photos is not None and len(shape) == 3
    images = some.draw(with_texture(shape), ("rgb", "alpha"))
    rgb, alpha = images.rgb.clamp(0, 1), images.alpha[:, None]  # type: ignore[union-attr, index]
    mask = some.masks[:, None]
    target = some.photos if some.photos is not None else mask * torch.tensor(CLAY).to(mask)[:, None, None]
    more, less = (alpha - mask).clamp(min=0), (mask - alpha).clamp(min=0)
    wrong = torch.cat((less, more + less, more), 1)
    if photos:
        wrong = torch.maximum(wrong, 2 * (rgb - target).abs().mean(1, keepdim=True) * torch.minimum(alpha, mask))
    stages = (target + 1 - mask, rgb + 1 - alpha, 1 - wrong.clamp(max=1))
    return torch.cat([torch.cat(list(stage), dim=2) for stage in stages], dim=1).clamp(0, 1).cpu()


def turntable(path: Path, views: Views, mesh: Mesh, frames: int = 36, size: int = 256) -> None:
    """Write an animation of the mesh going round the axis that is up in most views, as GIF or MP4."""
    up = F.normalize(views.camera.rotation[:, 1].mean(0) * (-1 if views.camera.K is not None else 1), dim=0)
    axis = F.one_hot(up.abs().argmax(), 3).to(up) * up[up.abs().argmax()].sign()
    upright = Mesh(mesh.vertices @ _turn(axis).t().to(mesh.vertices), mesh.faces, mesh.textures).normalize()
    angles = (145 + 360 * index / frames for index in range(frames))
    save_animation(path, [photograph(upright, angle, size=size).cpu() for angle in angles], fps=15)


def _turn(axis: Tensor) -> Tensor:
    """The rotation [3, 3] that turns a coordinate axis, or its opposite, up to +y."""
    axis = axis.cpu()
    across = torch.tensor([0.0, 0.0, 1.0]) if not bool(axis[2]) else torch.tensor([1.0, 0.0, 0.0])
    right = torch.linalg.cross(axis, across)
    return torch.stack((right, axis, torch.linalg.cross(right, axis)))
