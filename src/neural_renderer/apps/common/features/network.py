"""`FeatureNetwork`: a sequence of named stages after an input normalisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from ....base import validate

_LEAST_SIDE = 32  # pixels: any image this large survives the five halvings of a network

Plan = Mapping[str, Sequence[int]]
"""Shapes of a checkpoint's tensors, by name."""


class FeatureNetwork(nn.Module):
    """Convolutional network that returns the activations of named layers.

    Weights are frozen: gradients flow to the images only. Activations are taken after the ReLU, except those of the
    last layer of a classifier. `vgg`, `googlenet` and `load_features` make such networks.

    Args:
        name: Name of the architecture, such as "VGG-16".
        normalize: Module applied to the images first.
        stages: Modules by the name of their layer, in the order of computation.
        plan: Shapes of the tensors of the checkpoint, by name; None if there is no checkpoint.

    Attributes:
        name: Name of the architecture.
        layers: Names of all layers, in the order of computation.
        plan: As the argument; empty without a checkpoint. `features_like` builds a network from it.

    Example:
        >>> from neural_renderer.apps.common.features import vgg
        >>> weights = {"conv1_1.weight": torch.rand(8, 3, 3, 3), "conv1_1.bias": torch.zeros(8)}
        >>> weights |= {"conv1_2.weight": torch.rand(8, 8, 3, 3), "conv1_2.bias": torch.zeros(8)}
        >>> network = vgg(weights)
        >>> network.layers, network.until("conv1_1").layers
        (('conv1_1', 'conv1_2'), ('conv1_1',))
        >>> network.checked("conv1_2")
        ('conv1_2',)
        >>> network(torch.rand(4, 3, 32, 32), ["conv1_1"])["conv1_1"].shape
        torch.Size([4, 8, 32, 32])
    """

    def __init__(self, name: str, normalize: nn.Module, stages: dict[str, nn.Module], plan: Plan | None = None) -> None:
        super().__init__()
        self.name = name
        self._normalise = normalize  # this spelling is part of saved state_dicts
        self._stages = nn.ModuleDict(stages)
        self.layers = tuple(stages)
        self.plan: Plan = plan or {}
        self.requires_grad_(False)
        self.eval()

    def forward(self, images: Tensor, layers: Sequence[str]) -> dict[str, Tensor]:
        """Compute the activations of layers. Stages after the last requested layer are not computed.

        Args:
            images: [B, 3, H, W] floating, RGB in [0, 1].
            layers: Names of layers.

        Returns:
            [B, C, h, w] for each requested layer, by name; [B, C] for the layers of a classifier.

        Raises:
            TypeError, ValueError: The images do not fit or are too small for a layer, or a layer is unknown.
        """
        validate.floating("images", images, ("B", 3, "H", "W"))
        wanted = set(self.checked(layers))
        found: dict[str, Tensor] = {}
        values = self._normalise(images)
        if not images.is_cuda:  # a quarter faster on processors
            values = values.contiguous(memory_format=torch.channels_last)
        for name in self.layers:
            try:
                values = self._stages[name](values)
            except RuntimeError:  # from a pool or a padding that is larger than its input
                if min(images.shape[2:]) >= _LEAST_SIDE:
                    raise
                height, width = images.shape[2:]
                raise ValueError(f"images: expected larger ones for the layer {name}, got {width} x {height}") from None
            if name in wanted:
                found[name] = values
                if len(found) == len(wanted):
                    break
        return found

    def until(self, layer: str) -> FeatureNetwork:
        """Truncate the network after a layer.

        Args:
            layer: Name of the last layer to keep.

        Returns:
            The shorter network. Weights are shared, not copied.

        Raises:
            ValueError: The layer is unknown.
        """
        (layer,) = self.checked([layer])
        kept = self.layers[: self.layers.index(layer) + 1]
        return FeatureNetwork(self.name, self._normalise, {name: self._stages[name] for name in kept}, self.plan)

    def checked(self, layers: Sequence[str]) -> tuple[str, ...]:
        """Check names of layers.

        Args:
            layers: Names, or one name.

        Returns:
            The names as a tuple.

        Raises:
            ValueError: There are no names, or a layer is unknown.
        """
        layers = (layers,) if isinstance(layers, str) else tuple(layers)
        for name in layers or ("",):
            if name not in self.layers:
                raise ValueError(f"layer: expected one of {', '.join(self.layers)} of {self.name}, got {name!r}")
        return layers


def plan_of(weights: Mapping[str, Tensor]) -> Plan:
    """Collect the shapes of a checkpoint's tensors."""
    return {name: tuple(value.shape) for name, value in weights.items()}


class Normalize(nn.Module):
    """Input normalisation (255 · image − mean) / std of images in [0, 1]; channels are reversed to BGR if ``bgr``."""

    _gain: Tensor
    _offset: Tensor

    def __init__(self, mean: Sequence[float], std: Sequence[float] = (1, 1, 1), bgr: bool = False) -> None:
        super().__init__()
        self.register_buffer("_gain", 255 / torch.tensor(std, dtype=torch.float32)[:, None, None])
        self.register_buffer("_offset", (torch.tensor(mean) / torch.tensor(std)).float()[:, None, None])
        self._bgr = bgr

    def forward(self, images: Tensor) -> Tensor:
        """Normalise images [B, 3, H, W] of any floating dtype."""
        images = images.flip(1) if self._bgr else images
        return images * self._gain - self._offset


Padding = Literal["zeros", "reflect"]


def convolution(weight: Tensor, bias: Tensor, stride: int = 1, padding_mode: Padding = "zeros") -> nn.Conv2d:
    """Make a convolution with weight [O, I, k, k] and bias [O], padded so that the output has size input / stride."""
    out, inputs, side, _ = weight.shape
    layer = nn.Conv2d(inputs, out, side, stride, side // 2, padding_mode=padding_mode)
    layer.weight, layer.bias = nn.Parameter(weight), nn.Parameter(bias)
    return layer


def linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    """Make a fully connected layer with weight [O, I] and bias [O]."""
    layer = nn.Linear(1, 1)
    layer.out_features, layer.in_features = weight.shape
    layer.weight, layer.bias = nn.Parameter(weight), nn.Parameter(bias)
    return layer


def weight_and_bias(weights: Mapping[str, Tensor], name: str, shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Return the tensors of a layer from a checkpoint; ValueError unless the weight has the shape [·, *shape]."""
    weight, bias = weights.get(f"{name}.weight"), weights.get(f"{name}.bias")
    if weight is None or bias is None:
        raise ValueError(f"expected weight and bias of {name}, got neither or only one")
    if tuple(weight.shape[1:]) != shape or bias.shape != weight.shape[:1]:
        raise ValueError(f"expected {name}.weight of shape [·, {', '.join(map(str, shape))}], got {list(weight.shape)}")
    return weight, bias


IMAGENET_MEAN = (123.675, 116.28, 103.53)
IMAGENET_STD = (58.395, 57.12, 57.375)
