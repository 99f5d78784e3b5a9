"""A sphere deformed until its silhouettes are those of a target, then painted until its pictures are too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from .. import losses, metrics
from ..camera import Camera, get_points_from_angles
from ..mesh import Mesh
from ..optim import Adam
from ..primitives import icosphere
from ..render import render
from ..topology import Topology

Report = Callable[[int, float, Tensor], None]  # step, loss, vertices or textures


@dataclass(frozen=True)
class Views:
    """Cameras all around a target, and what they see of it."""

    eyes: Tensor  # [N, 3]
    silhouettes: Tensor  # [N, H, W]
    photos: Tensor  # [N, 3, 2H, 2W], without light
    masks: Tensor  # [N, 2H, 2W], the silhouettes at that size

    @classmethod
    def of(cls, target: Mesh, count: int, size: int) -> Views:
        """``count`` views, whose azimuths go round evenly and whose elevations take turns at three heights."""
        index = torch.arange(count)
        azimuth, elevation = 360 / count * index, torch.tensor([-25.0, 10.0, 40.0])[index % 3]
        eyes = get_points_from_angles(3.2, elevation, azimuth).to(target.vertices.device)
        with torch.no_grad():
            alpha = render((target.vertices, target.faces), camera(eyes), size, outputs="alpha").alpha
            photos = render(target, camera(eyes), 2 * size, light=None, outputs=("rgb", "alpha"))
        return cls(eyes, alpha, photos.rgb, photos.alpha)  # type: ignore[arg-type]

    def iou(self, vertices: Tensor, faces: Tensor) -> Tensor:
        """The intersection over union of each view's silhouette [N] with that of another shape."""
        with torch.no_grad():
            alpha = render((vertices, faces), camera(self.eyes), self.silhouettes.shape[-1], outputs="alpha").alpha
        return metrics.silhouette_iou(alpha, self.silhouettes)  # type: ignore[arg-type]


def camera(eyes: Tensor) -> Camera:
    """The cameras at ``eyes`` [B, 3] that look at the origin."""
    return Camera.look_at(eyes, viewing_angle=25.0)


def sphere(device: torch.device) -> tuple[Tensor, Tensor]:
    """What a sculpture begins as: vertices [642, 3] and faces [1280, 3]."""
    vertices, faces = icosphere(3, radius=0.5)
    return vertices.to(device), faces.to(device)


def sculpt(
    views: Views, vertices: Tensor, faces: Tensor, steps: int, report: Report, batch: int = 8, rate: float = 0.02
) -> Tensor:
    """Vertices [V, 3] moved, in ``steps`` steps of descent, until the mesh has the silhouettes of ``views``.

    Each step renders ``batch`` of the views; ``report`` is told of it. Silhouettes move only the vertices at the
    outline, each for itself, which tangles the surface. So the gradient is blurred over the surface, (1 + L)⁻² g with
    the graph Laplacian L, and one step size holds for all vertices (Nicolet, Jacobson and Jakob, "Large Steps in
    Inverse Rendering of Geometry", 2021).
    """
    size, device = views.silhouettes.shape[-1], views.eyes.device
    topology = Topology.of(faces)
    blur = torch.linalg.inv(torch.eye(len(vertices), device=device) + _graph_laplacian(topology))
    mean, scale = torch.zeros_like(vertices), torch.zeros((), device=device)
    for step in range(steps):
        chosen = torch.randperm(len(views.eyes))[:batch].to(device)
        vertices.requires_grad_()
        images = render((vertices, faces), camera(views.eyes[chosen]), size, outputs="alpha")
        loss = losses.silhouette_iou(images.alpha, views.silhouettes[chosen])  # type: ignore[arg-type]
        loss = loss + losses.laplacian(vertices, topology) + 0.02 * losses.normal_consistency(vertices, topology)
        (gradient,) = torch.autograd.grad(loss, vertices)
        gradient = blur @ (blur @ gradient)
        mean = 0.9 * mean + 0.1 * gradient
        scale = 0.98 * scale + 0.02 * gradient.square().sum(1).max()
        direction = mean / (1 - 0.9 ** (step + 1)) / (scale / (1 - 0.98 ** (step + 1))).sqrt().clamp(min=1e-12)
        slow = min(1.0, 2 * (1 - step / steps)) * 0.95 + 0.05  # from half of the way on, ever smaller steps
        vertices = vertices.detach() - rate * slow * direction
        report(step, loss.item(), vertices)
    return vertices


def paint(views: Views, vertices: Tensor, faces: Tensor, steps: int, report: Report, batch: int = 8) -> Mesh:
    """A mesh of this shape whose texture makes it look like ``views``, after ``steps`` steps of Adam."""
    textures = torch.full((len(faces), 4, 4, 4, 3), 0.7, device=vertices.device, requires_grad=True)
    optimizer = Adam([textures])
    for step in range(steps):
        chosen = torch.randperm(len(views.eyes))[:batch].to(vertices.device)
        shape = vertices, faces, textures
        images = render(shape, camera(views.eyes[chosen]), views.photos.shape[-1], light=None, outputs="rgb")
        loss = losses.photometric(images.rgb, views.photos[chosen], views.masks[chosen])  # type: ignore[arg-type]
        optimizer.param_groups[0]["lr"] = 0.1 * (1 - step / steps)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        report(step, loss.item(), textures)
    return Mesh(vertices, faces, textures.detach().clamp(0, 1))


def _graph_laplacian(topology: Topology) -> Tensor:
    """Degree − adjacency, [V, V]."""
    edges = topology.edges
    matrix = torch.zeros(topology.vertices, topology.vertices, device=edges.device)
    matrix[edges[:, 0], edges[:, 1]] = matrix[edges[:, 1], edges[:, 0]] = -1.0
    return matrix - torch.diag(matrix.sum(1))
