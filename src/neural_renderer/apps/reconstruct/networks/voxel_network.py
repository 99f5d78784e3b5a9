"""`VoxelNetwork`, the voxel baseline: perspective transformer nets (Yan, Yang, Yumer, Guo and Lee, NIPS 2016)."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...common.features import FeatureNetwork
from ..data.framing import DISTANCE, GRID, VIEWING_ANGLE, VIEWS, view_camera
from .configs import Config
from .encoders import FEATURES, make_encoder


class VoxelNetwork(nn.Module):
    """Network from images [B, 4, 64, 64] in [0, 1] to probabilities [B, 32, 32, 32] that voxels are filled.

    The axes are those of the published voxels: (y, x, −z) of the reconstruction frame.

    Attributes:
        kind: "voxel".
        config: Configuration of the network.
    """

    kind = "voxel"

    def __init__(self, config: Config, features: FeatureNetwork | None = None) -> None:
        super().__init__()
        self.config = config
        self.encoder = make_encoder(config.encoder, config.width, features)
        self.decoder = VoxelDecoder()
        self._rays: Tensor | None = None

    def forward(self, images: Tensor) -> Tensor:
        """Predict probabilities [B, 32, 32, 32] float32."""
        return torch.sigmoid(self.decoder(self.encoder(images)).float())

    def occupancy(self, images: Tensor) -> Tensor:
        """Predict probabilities [B, 32, 32, 32] float32, like `forward`."""
        return self(images)

    def silhouettes(self, shapes: Tensor, views: Tensor) -> Tensor:
        """Compute silhouettes [B, 32, 32] of voxels [B, 32, 32, 32] from views [B]: the maximum along each ray."""
        if self._rays is None or self._rays.device != shapes.device:
            self._rays = rays(shapes.device)
        samples = F.grid_sample(shapes[:, None], self._rays[views], align_corners=True)
        return samples.amax(2).squeeze(1)

    def regularizer(self, shapes: Tensor) -> Tensor:
        """Return 0: there is no regularisation."""
        return shapes.new_zeros(())


class VoxelDecoder(nn.Sequential):
    """Decoder from features [B, 512] to logits [B, 32, 32, 32]: a dense layer to 4³, three transposed convolutions.

    Without group normalisation, a few thousand steps end in one shape for all images.
    """

    def __init__(self, width: int = 64) -> None:
        widths = (width, width // 2, width // 4)
        layers: list[nn.Module] = [nn.Linear(FEATURES, 64 * width), nn.Unflatten(1, (width, 4, 4, 4))]
        for inward, outward in zip(widths, (*widths[1:], 1), strict=True):
            layers += [nn.GroupNorm(8, inward), nn.ReLU()]
            layers.append(nn.ConvTranspose3d(inward, outward, 4, stride=2, padding=1))
        super().__init__(*layers, nn.Flatten(1, 2))


def rays(device: torch.device, size: int = GRID, depths: int = GRID) -> Tensor:
    """Compute sample positions on the rays of all 24 views, [24, depths, size, size, 3], for `grid_sample`.

    Depths span the circumscribed ball of the cube [-½, ½]³. The centres of the outermost voxels are its corners.
    """
    place = (torch.arange(size) + 0.5) / size * 2 - 1
    depth = DISTANCE + math.sqrt(3) / 2 * ((torch.arange(depths) + 0.5) / depths * 2 - 1)
    z, y, x = torch.meshgrid(depth, -place, place, indexing="ij")
    slope = math.tan(math.radians(VIEWING_ANGLE))
    points = torch.stack((x * z * slope, y * z * slope, z), -1).to(device)
    camera = view_camera(torch.arange(VIEWS, device=device))
    world = torch.einsum("dhwc,vcr->vdhwr", points, camera.rotation) + camera.position[:, None, None, None]
    x, y, z = (2 * world).unbind(-1)
    return torch.stack((-z, x, y), -1)  # `grid_sample` takes the last axis of the voxels first
