"""`MeshNetwork`: images to meshes, by deforming a sphere (sections 4.1 and 5.1.1 of the paper)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ....meshes.primitives import icosphere
from ....meshes.topology import Topology
from ....optim.losses import laplacian, smoothness
from ....rendering.forward import render
from ...common.features import FeatureNetwork
from ..data.framing import SIZE, view_camera
from .configs import Config
from .encoders import FEATURES, make_encoder, published_init

_SHIFT_SCALE = 0.1  # factor of the global bias, as in the published code


class MeshNetwork(nn.Module):
    """Network from images [B, 4, 64, 64] in [0, 1] to vertices [B, 642, 3] in [-½, ½].

    Vertices are in the reconstruction frame (see `framing`).

    Args:
        config: Configuration of the network.
        features: Recognition network of the encoder "features".

    Attributes:
        kind: "mesh".
        config: Configuration of the network.
        faces: [1280, 3] int32, the same for all meshes.
        sphere: [642, 3], the undeformed sphere.
        partners: [642] int64, the mirror image of each vertex at z = 0.

    Raises:
        ValueError: The configuration's encoder needs ``features``, and they are missing or lack the layer.

    Example:
        >>> from neural_renderer.apps.reconstruct.networks.configs import make_config
        >>> network = MeshNetwork(make_config("small", ["chair"]))
        >>> shapes = network.vertices(torch.rand(1, 4, 64, 64))
        >>> network.silhouettes(shapes, views=torch.tensor([3])).shape
        torch.Size([1, 64, 64])
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
            self.register_buffer("blur", smoothing_matrix(self._topology, config.blur), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """Predict vertices [B, 642, 3] float32."""
        bias, shift = self.decoder(self.encoder(images))
        with torch.autocast(images.device.type, enabled=False):  # bfloat16 is too coarse for positions
            bias = self.blur @ bias.float() if self.config.blur else bias.float()
            return self.symmetrize(deform_sphere(self.sphere, bias, shift.float()))

    @property
    def topology(self) -> Topology:
        """Topology of the faces, on the device of the network."""
        if self._topology.edges.device != self.sphere.device:
            self._topology = self._topology.to(self.sphere.device)
        return self._topology

    def vertices(self, images: Tensor) -> Tensor:
        """Predict vertices, like `forward`.

        Args:
            images: [B, 4, 64, 64] floating, RGBA in [0, 1].

        Returns:
            [B, 642, 3] float32 in [-½, ½].

        Raises:
            RuntimeError: The shape does not fit.
        """
        return self(images)

    def silhouettes(self, shapes: Tensor, views: Tensor) -> Tensor:
        """Render silhouettes.

        Args:
            shapes: [B, 642, 3] floating, vertices.
            views: [B] int64, number of the view of each shape, 0 to 23.

        Returns:
            [B, 64, 64] float32 in [0, 1].

        Raises:
            TypeError, ValueError: As `render`.
        """
        config = self.config
        return render(
            (shapes, self.faces),
            view_camera(views),
            SIZE,
            outputs="alpha",
            gradient=config.gradient,
            anti_aliasing=config.anti_aliasing,
        ).alpha

    def symmetrize(self, vertices: Tensor) -> Tensor:
        """Average vertices [B, 642, 3] with their mirror images at z = 0, if the configuration is symmetric."""
        if not self.config.symmetric:
            return vertices
        reflected = vertices[:, self.partners] * vertices.new_tensor([1.0, 1.0, -1.0])
        return (vertices + reflected) / 2

    def regularizer(self, shapes: Tensor) -> Tensor:
        """Compute the weighted regularisation losses of vertices [B, 642, 3]."""
        loss = shapes.new_zeros(())
        if self.config.smoothness:
            loss = loss + self.config.smoothness * smoothness(shapes, self.topology)
        if self.config.laplacian:
            loss = loss + self.config.laplacian * laplacian(shapes, self.topology)
        return loss


class MeshDecoder(nn.Module):
    """Decoder from features [B, 512] to local biases [B, V, 3] and a global bias [B, 3], b and c in the paper."""

    def __init__(self, vertices: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        width = FEATURES
        for wider in hidden:
            layers += [nn.Linear(width, wider), nn.ReLU()]
            width = wider
        self.hidden = nn.Sequential(*layers)
        self.local_bias = nn.Linear(width, 3 * vertices)
        self.global_bias = nn.Linear(width, 3)
        self.apply(published_init)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Decode features [B, 512] to local biases [B, V, 3] and global bias [B, 3]."""
        hidden = self.hidden(features)
        return self.local_bias(hidden).unflatten(1, (-1, 3)), _SHIFT_SCALE * self.global_bias(hidden)


def deform_sphere(sphere: Tensor, bias: Tensor, shift: Tensor) -> Tensor:
    """Deform a sphere [V, 3] in [-½, ½] by local biases [B, V, 3] and a shift [B, 3]; no vertex leaves its octant.

    Per coordinate s of the sphere: ``m = sign(s) sigmoid(logit |s| + bias)``, ``c = tanh(shift)``, and the result is
    ``½ (max(m, 0)(1 − c) − max(−m, 0)(1 + c) + c)``. The common corner of the octants is at c/2.
    """
    size = torch.sigmoid(torch.logit(sphere.abs()) + bias)
    signed = size * sphere.sign()
    center = torch.tanh(shift)[:, None]
    return (signed.clamp(min=0) * (1 - center) - (-signed).clamp(min=0) * (1 + center) + center) / 2


def smoothing_matrix(topology: Topology, strength: float) -> Tensor:
    """Compute the matrix (1 + λL)⁻¹ [V, V] float32, with the graph Laplacian L and λ = ``strength`` ≥ 0.

    It averages over about √λ edges. Sampling and low precision add noise to single vertices, and silhouette losses do
    not remove it, because silhouettes do not show dents. Smoothed updates move neighbours alike; over many steps they
    can still reach any shape. See Nicolet, Jacobson and Jakob, "Large Steps in Inverse Rendering of Geometry" (2021),
    section 3.
    """
    start, end = topology.edges.unbind(1)
    matrix = torch.eye(topology.vertices, dtype=torch.float64, device=start.device)
    matrix.index_put_((torch.cat((start, end)), torch.cat((end, start))), matrix.new_tensor(-strength))
    matrix.diagonal().copy_(2 - matrix.sum(1))
    return torch.linalg.inv(matrix).float()
