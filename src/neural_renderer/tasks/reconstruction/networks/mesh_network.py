"""From images to meshes: the deformation of a sphere (sections 4.1 and 5.1.1 of the paper)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ....features import FeatureNetwork
from ....losses import laplacian, smoothness
from ....meshes.primitives import icosphere
from ....meshes.topology import Topology
from ....rendering import render
from ..data.framing import SIZE, view_camera
from .configs import Config
from .encoders import FEATURES, make_encoder, published_start


class MeshNetwork(nn.Module):
    """Images [B, 4, 64, 64] in [0, 1] to vertices [B, 642, 3] in [-½, ½]; `faces` [1280, 3] are the same for all.

    The vertices are in the frame of `framing`, a mirror image of the models' own; see there.
    """

    kind = "mesh"

    sphere: Tensor
    faces: Tensor
    partners: Tensor
    blur: Tensor

    def __init__(self, config: Config, features: FeatureNetwork | None = None) -> None:
        super().__init__()
        self.config = config
        vertices, faces = icosphere(3)
        self.register_buffer("sphere", vertices * 0.5, persistent=False)
        self.register_buffer("faces", faces, persistent=False)
        mirrored = vertices * torch.tensor([1.0, 1.0, -1.0])
        self.register_buffer("partners", torch.cdist(mirrored, vertices).argmin(1), persistent=False)
        self.encoder = make_encoder(config.encoder, config.width, features)
        self.decoder = MeshDecoder(len(vertices), config.hidden)
        self._topology = Topology.of(faces)
        if config.blur:
            self.register_buffer("blur", blurring(self._topology, config.blur), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """Vertices [B, 642, 3] float32."""
        bias, shift = self.decoder(self.encoder(images))
        with torch.autocast(images.device.type, enabled=False):  # positions need more digits than features
            bias = self.blur @ bias.float() if self.config.blur else bias.float()
            return self.symmetrised(in_octants(self.sphere, bias, shift.float()))

    @property
    def topology(self) -> Topology:
        """Of the faces, where the network is."""
        if self._topology.edges.device != self.sphere.device:
            self._topology = self._topology.to(self.sphere.device)
        return self._topology

    def vertices(self, images: Tensor) -> Tensor:
        """What `forward` returns."""
        return self(images)

    def silhouettes(self, shapes: Tensor, views: Tensor) -> Tensor:
        """Silhouettes [B, 64, 64] in [0, 1] of vertices [B, 642, 3] from ``views`` [B]."""
        config = self.config
        return render(
            (shapes, self.faces),
            view_camera(views),
            SIZE,
            outputs="alpha",
            gradient=config.gradient,
            anti_aliasing=config.anti_aliasing,
        ).alpha  # type: ignore[return-value]

    def symmetrised(self, vertices: Tensor) -> Tensor:
        """Vertices [B, 642, 3] averaged with their mirror images at z = 0, if the recipe is of symmetric meshes."""
        if not self.config.symmetric:
            return vertices
        reflected = vertices[:, self.partners] * vertices.new_tensor([1.0, 1.0, -1.0])
        return (vertices + reflected) / 2

    def regulariser(self, shapes: Tensor) -> Tensor:
        """The weighted losses that look at vertices [B, 642, 3] alone."""
        loss = shapes.new_zeros(())
        if self.config.smoothness:
            loss = loss + self.config.smoothness * smoothness(shapes, self.topology)
        if self.config.laplacian:
            loss = loss + self.config.laplacian * laplacian(shapes, self.topology)
        return loss


class MeshDecoder(nn.Module):
    """Features [B, 512] to the local biases [B, V, 3] of the vertices and one global bias [B, 3] (the paper's b and c).

    ``hidden``: the widths of the hidden layers, (1024, 2048) in the paper.
    """

    def __init__(self, vertices: int, hidden: tuple[int, ...] = (1024, 2048)) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        width = FEATURES
        for wider in hidden:
            layers += [nn.Linear(width, wider), nn.ReLU()]
            width = wider
        self.hidden = nn.Sequential(*layers)
        self.local_bias = nn.Linear(width, 3 * vertices)
        self.global_bias = nn.Linear(width, 3)
        self.apply(published_start)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        hidden = self.hidden(features)
        return self.local_bias(hidden).unflatten(1, (-1, 3)), 0.1 * self.global_bias(hidden)


def in_octants(sphere: Tensor, bias: Tensor, shift: Tensor) -> Tensor:
    """The vertices [B, V, 3] of a sphere [V, 3] in [-½, ½] moved by bias [B, V, 3] and shift [B, 3].

    No vertex leaves its octant, whose corner moves with the shift: per coordinate m = ±sigmoid(logit |s| + b) with the
    sign of the sphere's s; with c = tanh(shift) the result is ½ (max(m, 0)(1 − c) − max(−m, 0)(1 + c) + c), which is in
    [-½, ½] for any input. Where s = 0 it is c/2.
    """
    size = torch.sigmoid(torch.logit(sphere.abs()) + bias)
    signed = size * sphere.sign()
    centre = torch.tanh(shift)[:, None]
    return (signed.clamp(min=0) * (1 - centre) - (-signed).clamp(min=0) * (1 + centre) + centre) / 2


def blurring(topology: Topology, strength: float) -> Tensor:
    """The matrix (1 + λL)⁻¹ [V, V] float32 of a mesh, with its graph Laplacian L and λ = ``strength`` ≥ 0.

    What it is applied to is averaged over about √λ edges. Silhouettes do not see dents, so that nothing would take out
    what chance, the learning rate and half precision put into the vertices one by one; but blurred, a step moves
    neighbours alike, and steps that agree still reach any shape. After "Large Steps in Inverse Rendering of Geometry"
    (Nicolet, Jacobson and Jakob, 2021), section 3.
    """
    start, end = topology.edges.unbind(1)
    matrix = torch.eye(topology.vertices, dtype=torch.float64, device=start.device)
    matrix.index_put_((torch.cat((start, end)), torch.cat((end, start))), matrix.new_tensor(-strength))
    matrix.diagonal().copy_(2 - matrix.sum(1))
    return torch.linalg.inv(matrix).float()
