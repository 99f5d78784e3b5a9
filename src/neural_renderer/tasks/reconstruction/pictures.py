"""What a network predicts, as a picture to look at while it is trained."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...lighting import Light
from ...render import render
from .arrays import Split
from .framing import SIZE, VIEWS, view_camera
from .mesh_network import MeshNetwork
from .networks import Model

_CLAY = (0.86, 0.84, 0.8)
_LIGHT = Light(0.45, 0.55, direction=(0.4, 1.0, -0.6))


@torch.no_grad()
def prediction_sheet(model: Model, split: Split, rows: int = 13, turns: tuple[int, ...] = (0, 6, 15)) -> Tensor:
    """The first object of each of up to ``rows`` classes: the input, the prediction from views that are ``turns``
    further around, and the object's images from there. [3, rows · 64, (1 + 2 · turns) · 64] in [0, 1], on white.
    """
    device = next(model.parameters()).device
    names = split.classes[:rows]
    objects = torch.stack([torch.from_numpy(split.images[name][0].copy()) for name in names]).to(device).float() / 255
    looks = (torch.arange(len(names), device=device) * 7 + 2) % VIEWS
    here = torch.arange(len(names), device=device)
    shapes = model(objects[here, looks])
    columns = [_on_white(objects[here, looks])]
    views = [(looks + turn) % VIEWS for turn in turns]
    columns += [_drawn(model, shapes, view) for view in views]
    columns += [_on_white(objects[here, view]) for view in views]
    return torch.cat([torch.cat(list(column), 1) for column in columns], 2).clamp(0, 1).cpu()


def _drawn(model: Model, shapes: Tensor, views: Tensor) -> Tensor:
    """Meshes as of clay, voxels as silhouettes: [B, 3, 64, 64]."""
    clay = shapes.new_tensor(_CLAY)
    if isinstance(model, MeshNetwork):
        textures = clay.expand(len(model.faces), 2, 2, 2, 3)
        images = render((shapes, model.faces, textures), view_camera(views), SIZE, light=_LIGHT)
        return images.rgb + 1 - images.alpha[:, None]  # type: ignore[operator, index]
    alpha = F.interpolate(model.silhouettes(shapes, views)[:, None], size=(SIZE, SIZE), mode="nearest")
    return alpha * clay[:, None, None] * 0.7 + 1 - alpha


def _on_white(images: Tensor) -> Tensor:
    return images[:, :3] * images[:, 3:] + 1 - images[:, 3:]
