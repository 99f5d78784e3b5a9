"""Pictures of a fit: comparisons with the views, and the mesh rotated upright."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...meshes.mesh import Mesh
from ..common.pictures.clay import CLAY
from ..common.views.up import up_of_cameras
from ..common.views.views import Views
from .mesh import with_texture

_SLANTED = 0.9  # above this cosine two directions are too close to span a plane


@torch.no_grad()
def comparison(views: Views, shape: tuple[Tensor, ...], columns: int = 6) -> Tensor:
    """Draw targets, results and differences of some views in three rows: [3, 3 · H, columns · W] in [0, 1], on the CPU.

    Differences of silhouettes are red where the result has too much and blue where it has too little. Differences of
    colours are grey. White means equal. Views with backgrounds are whole photographs, and differ only by colours, as
    their masks may be wrong. The shape is (vertices, faces) or (vertices, faces, textures), in the world of the views;
    those shown are evenly spaced.
    """
    some = views[sorted({round(i * (len(views) - 1) / max(columns - 1, 1)) for i in range(columns)})]
    colored = len(shape) == 3
    images = some.draw(with_texture(shape), ("rgb", "alpha"))
    rgb, alpha = images.rgb.clamp(0, 1), images.alpha[:, None]
    mask = some.masks[:, None]
    target = some.photos if some.photos is not None else mask * torch.tensor(CLAY).to(mask)[:, None, None]
    target = target + 1 - mask
    excess, lack = (alpha - mask).clamp(min=0), (mask - alpha).clamp(min=0)
    difference = torch.cat((lack, excess + lack, excess), 1)
    if colored and some.backgrounds is not None and some.scenes is not None:
        difference = 2 * (rgb - some.cut_out(images.alpha)).abs().mean(1, keepdim=True).expand(-1, 3, -1, -1)
        target = some.scenes
    elif colored and some.photos is not None:
        colors = 2 * (rgb - some.photos).abs().mean(1, keepdim=True) * torch.minimum(alpha, mask)
        difference = torch.maximum(difference, colors)
    rows = (target, rgb + 1 - alpha, 1 - difference.clamp(max=1))
    return torch.cat([torch.cat(list(row), dim=2) for row in rows], dim=1).clamp(0, 1).cpu()


def upright(mesh: Mesh, views: Views, up: tuple[float, float, float] | None = None) -> Mesh:
    """Scale a mesh to [-1, 1]³, and rotate ``up``, by default the up direction of its cameras, to +y."""
    direction = up_of_cameras(views) if up is None else torch.tensor(up)
    rotation = _rotation_to_y(F.normalize(direction.cpu().float(), dim=0))
    return Mesh(mesh.vertices @ rotation.t().to(mesh.vertices), mesh.faces, mesh.cubes()).normalize()


def _rotation_to_y(axis: Tensor) -> Tensor:
    """Make the rotation [3, 3] that takes a unit vector to +y, and is the identity for +y."""
    across = torch.tensor([0.0, 0.0, 1.0]) if abs(float(axis[2])) < _SLANTED else torch.tensor([1.0, 0.0, 0.0])
    right = F.normalize(torch.linalg.cross(axis, across), dim=0)
    return torch.stack((right, axis, torch.linalg.cross(right, axis)))
