"""A predicted mesh held to the one thing that is known of its object: the silhouette that went in.

A network that has seen few objects tells roughly what one is and how it is turned, but not its proportions; its
silhouette does, from one side, and the renderer's gradient carries that over to the mesh.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ....losses import laplacian, silhouette_iou_loss
from ..data.framing import VIEWS
from ..networks.make_network import Model
from ..networks.mesh_network import MeshNetwork, blurring

_RATE, _BETAS = 0.01, (0.7, 0.9)  # of Adam; vertices move in lengths of the object
_BLUR, _LAPLACIAN = 3.0, 3.0  # as of the recipe "best"


def chosen_steps(model: Model, asked: int | None) -> int:
    """The steps of `refined` that were asked for, or else the recipe's; voxels have none."""
    if model.kind == "voxel":
        return 0
    return model.config.refine if asked is None else asked


def refined(network: MeshNetwork, vertices: Tensor, images: Tensor, steps: int) -> Tensor:
    """What a network has predicted, moved so that the images' silhouettes are those of the meshes.

    vertices: [B, 642, 3] floating, as the network gives them. images: [B, 4, 64, 64] in [0, 1], which they are of.

    From which of the 24 views an image was taken is not known: it is taken for the one from which the prediction's
    silhouette is most like the image's. From there ``steps`` of Adam lessen 1 − IoU, for each mesh by itself; moves are
    blurred over the sphere (see `mesh_network.blurring`), symmetric meshes stay symmetric, and a Laplacian loss holds
    what cannot be seen. Returns [B, 642, 3] in [-½, ½], without a gradient; of 0 steps, the vertices as they are.
    """
    if not steps:
        return vertices
    vertices, masks = vertices.detach(), images[:, 3]
    views = likeliest_views(network, vertices, masks)
    spread = blurring(network.topology, _BLUR)

    def moved() -> Tensor:
        return network.symmetrised((vertices + spread @ moves).clamp(-0.5, 0.5))

    moves = torch.zeros_like(vertices, requires_grad=True)
    optimiser = torch.optim.Adam([moves], _RATE, _BETAS)
    for _ in range(steps):
        with torch.enable_grad():
            shapes = moved()
            error = silhouette_iou_loss(network.silhouettes(shapes, views), masks)
            loss = len(shapes) * (error + _LAPLACIAN * laplacian(shapes, network.topology))
        (moves.grad,) = torch.autograd.grad(loss, moves)
        optimiser.step()
    return moved().detach()


@torch.no_grad()
def likeliest_views(network: MeshNetwork, vertices: Tensor, masks: Tensor) -> Tensor:
    """The views [B] int64 from which the silhouettes of vertices [B, 642, 3] are most like masks [B, 64, 64]."""
    agreement = []
    for view in range(VIEWS):
        drawn = network.silhouettes(vertices, torch.full((len(vertices),), view, device=vertices.device))
        common = (drawn * masks).sum((1, 2))
        agreement.append(common / (drawn.sum((1, 2)) + masks.sum((1, 2)) - common).clamp(min=1e-6))
    return torch.stack(agreement).argmax(0)
