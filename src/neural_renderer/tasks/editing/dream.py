"""DeepDream on a mesh (sections 4.2 and 5.2 of the paper), as losses on its images."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from ... import losses, validate
from ...features import FeatureNetwork
from ..settings import DREAM_LAYER
from .deformation import Deformation


@dataclass(frozen=True)
class DreamWeights:
    """How much each loss counts beside the dream, whose weight is 1."""

    bend: float = 1.0
    """Squared difference of the movements of an edge's ends, in lengths of that edge."""
    variation: float = 1.0
    """Squared difference of neighbouring pixels' colours."""
    edges: float = 0.0
    """Variance of the edges' lengths, over their mean square at the start."""


PUBLISHED_DREAM = DreamWeights(bend=0.0, variation=0.0, edges=1e-4)
"""The published code's, for sums (``relative=False``)."""


class Dream:
    """Minus the squared norm of a layer of the images of an object, with what keeps a mesh a mesh.

    With ``relative`` it is minus the logarithm of the norm: its gradient has the same direction, and a size that does
    not depend on the network's scale, so that the other losses' weights mean the same for every network and layer.
    Without it the losses are those of the published code: minus the mean of the squares, and F times the variance of
    the edges.

    Args:
        network: with the layer.
        layer: one of the network's.
        channel: only this one of the layer's channels; all by default.
        weights: of the other losses.
        relative: see above.

    Raises ValueError for an unknown layer or channel and for a weight below 0.
    """

    name = "dream"

    def __init__(
        self,
        network: FeatureNetwork,
        *,
        layer: str = DREAM_LAYER,
        channel: int | None = None,
        weights: DreamWeights = DreamWeights(),
        relative: bool = True,
    ) -> None:
        for name, value in asdict(weights).items():
            validate.not_negative(name, value)
        (self._layer,) = network.checked(layer)
        self._network, self._channel, self._weights, self._relative = network, channel, weights, relative
        device = next(network.parameters()).device
        self.plain = torch.full((3,), 0.5, device=device)
        with torch.no_grad():
            channels = network(torch.zeros(1, 3, 64, 64, device=device), layer)[layer].shape[1]
        if channel is not None and not 0 <= channel < channels:
            raise ValueError(f"channel: expected one of the {channels} of {layer}, 0 to {channels - 1}, got {channel}")

    def background(self, count: int, generator: torch.Generator) -> Tensor:
        """One random grey for all images, [count, 3]."""
        return torch.rand(1, 1, generator=generator).expand(count, 3)

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation) -> dict[str, Tensor]:
        """What to minimise the sum of: ``dream``, ``bend``, ``variation`` and ``edges``, each with its weight.

        Args:
            images: [B, 3, H, W] in [0, 1].
            masks: [B, H, W] in [0, 1].
            shape: of the mesh.
        """
        norm, inside = self._norms(images).mean(), (masks == 1).to(images.dtype)
        variation, edges = losses.total_variation(images, inside), shape.edge_variance
        if self._relative:
            norm = norm.clamp(min=1e-12).log()
            variation, edges = variation / inside.sum().clamp(min=1), edges / shape.edge
        else:
            # Of k faces at an edge, the topology has one as the edge and the others as hinges: three to a face.
            edges = edges * ((len(shape.topology.edges) + len(shape.topology.hinges)) / 3)
        return {
            "dream": -norm,
            "bend": self._weights.bend * shape.bend,
            "variation": self._weights.variation * variation,
            "edges": self._weights.edges * edges,
        }

    @torch.no_grad()
    def measure(self, images: Tensor, masks: Tensor) -> Tensor:
        """The mean square of the layer for each image, [B]."""
        return self._norms(images)

    def _norms(self, images: Tensor) -> Tensor:
        features = self._network(images, self._layer)[self._layer]
        features = features if self._channel is None else features[:, self._channel : self._channel + 1]
        return features.square().flatten(1).mean(1)
