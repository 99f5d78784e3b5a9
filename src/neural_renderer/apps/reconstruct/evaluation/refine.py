"""Test-time refinement: fits a predicted mesh to the silhouette of the input image.

A network trained on few objects predicts class and pose better than proportions. The silhouette shows the proportions
from one side, and the renderer's gradient transfers them to the mesh.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ....compat.first_packages.adam import Adam
from ....optim.losses import laplacian, silhouette_iou_loss
from ..data.framing import VIEWS
from ..networks.checkpoint import Model
from ..networks.mesh_network import MeshNetwork, smoothing_matrix
from ..networks.shape_network import ShapeNetwork

_RATE, _BETAS = 0.01, (0.7, 0.9)  # settings of Adam; displacements are in units of the object's longest side
_BLUR, _LAPLACIAN = 3.0, 3.0  # strength and weight as in the configuration "best"


def refine_steps(model: Model | ShapeNetwork, requested: int | None) -> int:
    """Choose the number of steps: the requested one, or the configuration's if None; 0 for voxels."""
    if not isinstance(model, MeshNetwork):
        return 0
    return model.config.refine if requested is None else requested


def refine_meshes(
    network: MeshNetwork,
    vertices: Tensor,
    images: Tensor,
    steps: int,
    observe: Callable[[int, float, Callable[[], Tensor]], bool] | None = None,
) -> Tensor:
    """Fit predicted meshes to the silhouettes of their input images.

    The view of an image is unknown. Of the 24 views, the one with the best IoU between prediction and image is used.
    Adam then minimises 1 − IoU for each mesh. Displacements are smoothed over the sphere (see
    `mesh_network.smoothing_matrix`), symmetric meshes stay symmetric, and a Laplacian loss regularises hidden parts.

    Args:
        network: The network of the prediction.
        vertices: [B, 642, 3] floating, predicted vertices.
        images: [B, 4, 64, 64] in [0, 1], the input images.
        steps: Number of steps; 0 returns ``vertices``.
        observe: Called after each step with the number of steps taken, the loss before it, and a function that makes
            the current vertices. The refinement ends when it returns False.

    Returns:
        [B, 642, 3] in [-½, ½], detached.

    Raises:
        TypeError, ValueError: As `render`, or the numbers of images and meshes differ.

    Example:
        >>> from neural_renderer.apps.reconstruct.networks.configs import make_config
        >>> network, images = MeshNetwork(make_config("small", ["chair"])), torch.rand(1, 4, 64, 64)
        >>> refine_meshes(network, network.vertices(images), images, steps=1).shape
        torch.Size([1, 642, 3])
    """
    if not steps:
        return vertices
    vertices, masks = vertices.detach(), images[:, 3]
    views = best_matching_views(network, vertices, masks)
    smoothing = smoothing_matrix(network.topology, _BLUR)

    def displaced() -> Tensor:
        return network.symmetrize((vertices + smoothing @ displacement).clamp(-0.5, 0.5))

    displacement = torch.zeros_like(vertices, requires_grad=True)
    optimizer = Adam([displacement], _RATE, _BETAS)  # torch's imports its compiler, a second
    for step in range(1, steps + 1):
        with torch.enable_grad():
            shapes = displaced()
            error = silhouette_iou_loss(network.silhouettes(shapes, views), masks)
            loss = len(shapes) * (error + _LAPLACIAN * laplacian(shapes, network.topology))
        (displacement.grad,) = torch.autograd.grad(loss, displacement)
        optimizer.step()
        if observe is None:
            continue
        if not observe(step, float(loss.detach()) / len(vertices), lambda: displaced().detach()):
            break
    return displaced().detach()


@torch.no_grad()
def best_matching_views(network: MeshNetwork, vertices: Tensor, masks: Tensor) -> Tensor:
    """Find the view [B] int64 in which each mesh [B, 642, 3] has the largest IoU with its mask [B, 64, 64]."""
    iou = []
    for view in range(VIEWS):
        alpha = network.silhouettes(vertices, torch.full((len(vertices),), view, device=vertices.device))
        common = (alpha * masks).sum((1, 2))
        iou.append(common / (alpha.sum((1, 2)) + masks.sum((1, 2)) - common).clamp(min=1e-6))
    return torch.stack(iou).argmax(0)
