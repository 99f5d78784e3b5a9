"""DeepDream on a mesh (sections 4.2 and 5.2 of the paper): losses on its images."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from ...base import validate
from ...optim import losses
from ..common.features import FeatureNetwork
from .objective import Deformation, Objective
from .options import DREAM_LAYER


@dataclass(frozen=True)
class DreamWeights:
    """Weights of the losses of `Dream`. The weight of the dream loss is 1.

    Attributes:
        bend: Weight of the bending loss, ≥ 0 (`Deformation.bend`).
        variation: Weight of the total variation of the images, ≥ 0.
        edges: Weight of the variance of edge lengths, ≥ 0. The variance is relative to the initial mean square length.

    Raises:
        TypeError, ValueError: In `Dream`, a weight that is not a finite number ≥ 0.

    Example:
        >>> from neural_renderer.apps.edit import DreamWeights
        >>> DreamWeights(variation=2.0)
        DreamWeights(bend=1.0, variation=2.0, edges=0.0)
    """

    bend: float = 1.0
    variation: float = 1.0
    edges: float = 0.0


PUBLISHED_DREAM = DreamWeights(bend=0.0, variation=0.0, edges=1e-4)
"""Weights of the published code, for losses that are sums (``relative=False``)."""


class Dream(Objective):
    """Objective of DeepDream: large activations of a layer, with regularisers for shape and colours.

    The losses are "dream", "bend", "variation" and "edges"; `measure` returns the mean squared activation of the layer.
    The background is a random grey, the same for all images.

    With ``relative``, the dream loss is minus the logarithm of the mean squared activation. Its gradient does not
    depend on the scale of the network, so that one set of weights suits all networks and layers. Without it, the
    losses follow the published code: minus the mean squared activation, and the variance of edge lengths times the
    number of faces.

    Args:
        network: Feature network with the layer.
        layer: Name of the layer.
        channel: Channel of the layer, from 0; None for all channels.
        weights: Weights of the other losses.
        relative: Whether losses are relative.

    Attributes:
        name: "dream".
        plain: [3], grey, the initial colour of a mesh without colours.
        weights: Weights of the other losses. They may be replaced between two steps.

    Raises:
        ValueError: The layer or the channel is unknown, or a weight is below 0.

    Example:
        >>> from neural_renderer.apps.common.features import vgg
        >>> from neural_renderer.apps.edit import Dream
        >>> network = vgg({"conv1_1.weight": torch.rand(8, 3, 3, 3), "conv1_1.bias": torch.zeros(8)})
        >>> dream = Dream(network, layer="conv1_1", channel=3)
        >>> dream.background(2, torch.Generator()).shape
        torch.Size([2, 3])
        >>> dream.measure(torch.rand(2, 3, 64, 64), torch.ones(2, 64, 64)).shape
        torch.Size([2])
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
        self._network, self._channel, self.weights, self._relative = network, channel, weights, relative
        device = next(network.parameters()).device
        self.plain = torch.full((3,), 0.5, device=device)
        with torch.no_grad():
            channels = network(torch.zeros(1, 3, 64, 64, device=device), layer)[layer].shape[1]
        if channel is not None and not 0 <= channel < channels:
            raise ValueError(f"channel: expected one of the {channels} of {layer}, 0 to {channels - 1}, got {channel}")

    def background(self, count: int, generator: torch.Generator) -> Tensor:
        return torch.rand(1, 1, generator=generator).expand(count, 3)

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation) -> dict[str, Tensor]:
        norm, inside = self._norms(images).mean(), (masks == 1).to(images.dtype)
        variation, edges = losses.total_variation(images, inside), shape.edge_variance
        if self._relative:
            norm = norm.clamp(min=1e-12).log()
            variation, edges = variation / inside.sum().clamp(min=1), edges / shape.edge
        else:
            # The number of faces: an edge of k faces counts once in `edges` and k − 1 times in `hinges`.
            edges = edges * ((len(shape.topology.edges) + len(shape.topology.hinges)) / 3)
        return {
            "dream": -norm,
            "bend": self.weights.bend * shape.bend,
            "variation": self.weights.variation * variation,
            "edges": self.weights.edges * edges,
        }

    @torch.no_grad()
    def measure(self, images: Tensor, masks: Tensor) -> Tensor:
        return self._norms(images)

    def _norms(self, images: Tensor) -> Tensor:
        """Compute the mean squared activation of each image, [B]; differentiable."""
        features = self._network(images, self._layer)[self._layer]
        features = features if self._channel is None else features[:, self._channel : self._channel + 1]
        return features.square().flatten(1).mean(1)
