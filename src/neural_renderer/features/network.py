"""What all feature networks have in common: stages with names, one after the other, and an input of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from .. import validate

_ALWAYS_ENOUGH = 32  # pixels: five halvings

Plan = Mapping[str, Sequence[int]]
"""The shapes of a checkpoint's tensors by their names."""


class FeatureNetwork(nn.Module):
    """A convolutional network that returns what its named layers see in images.

    >>> network = load_features("googlenet_bvlc.safetensors")  # doctest: +SKIP
    >>> network(images, ["inception_4c"])["inception_4c"].shape  # doctest: +SKIP
    torch.Size([4, 512, 14, 14])

    Its weights are fixed: gradients flow to the images only. Layers are taken after their ReLU, except the last one of
    a classifier.

    Attributes:
        layers: the names of all layers in the order in which they are computed.
        name: which network it is.
        plan: of the checkpoint that it was made from, for `features_like`; empty for one that was made otherwise.
    """

    def __init__(self, name: str, normalise: nn.Module, stages: dict[str, nn.Module], plan: Plan | None = None) -> None:
        super().__init__()
        self.name = name
        self._normalise = normalise
        self._stages = nn.ModuleDict(stages)
        self.layers = tuple(stages)
        self.plan: Plan = plan or {}
        self.requires_grad_(False)
        self.eval()

    def forward(self, images: Tensor, layers: Sequence[str]) -> dict[str, Tensor]:
        """The layers named, of images [B, 3, H, W] with red, green and blue in [0, 1].

        Returns [B, C, h, w] for each layer, [B, C] for those of a classifier. Nothing behind the last layer asked for
        is computed. Raises TypeError or ValueError for other images, for some too small for a layer, and for a name not
        in ``layers``.
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
            except RuntimeError:  # a pool, or a padding, of less than there has to be
                if min(images.shape[2:]) >= _ALWAYS_ENOUGH:
                    raise
                height, width = images.shape[2:]
                raise ValueError(f"images: expected larger ones for the layer {name}, got {width} x {height}") from None
            if name in wanted:
                found[name] = values
                if len(found) == len(wanted):
                    break
        return found

    def until(self, layer: str) -> FeatureNetwork:
        """The part of the network up to this layer, with the same weights, not copies; ValueError for no layer."""
        (layer,) = self.checked([layer])
        kept = self.layers[: self.layers.index(layer) + 1]
        return FeatureNetwork(self.name, self._normalise, {name: self._stages[name] for name in kept}, self.plan)

    def checked(self, layers: Sequence[str]) -> tuple[str, ...]:
        """``layers`` if they are names of layers, at least one; ValueError otherwise."""
        layers = (layers,) if isinstance(layers, str) else tuple(layers)
        for name in layers or ("",):
            if name not in self.layers:
                raise ValueError(f"layer: expected one of {', '.join(self.layers)} of {self.name}, got {name!r}")
        return layers


def plan_of(weights: Mapping[str, Tensor]) -> Plan:
    """The plan of a checkpoint."""
    return {name: tuple(value.shape) for name, value in weights.items()}


class Normalise(nn.Module):
    """Images in [0, 1] as a network wants them: (255 · image − mean) / std, in the order BGR if ``bgr``."""

    _gain: Tensor
    _offset: Tensor

    def __init__(self, mean: Sequence[float], std: Sequence[float] = (1, 1, 1), bgr: bool = False) -> None:
        super().__init__()
        self.register_buffer("_gain", 255 / torch.tensor(std, dtype=torch.float32)[:, None, None])
        self.register_buffer("_offset", (torch.tensor(mean) / torch.tensor(std)).float()[:, None, None])
        self._bgr = bgr

    def forward(self, images: Tensor) -> Tensor:
        """[B, 3, H, W] of any floating type."""
        images = images.flip(1) if self._bgr else images
        return images * self._gain - self._offset


Padding = Literal["zeros", "reflect"]


def convolution(weight: Tensor, bias: Tensor, stride: int = 1, padding_mode: Padding = "zeros") -> nn.Conv2d:
    """A convolution with given weights [O, I, k, k] and [O], whose output is as large as its input / stride."""
    out, inputs, side, _ = weight.shape
    layer = nn.Conv2d(inputs, out, side, stride, side // 2, padding_mode=padding_mode)
    layer.weight, layer.bias = nn.Parameter(weight), nn.Parameter(bias)
    return layer


def linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    """A fully connected layer with given weights [O, I] and [O]."""
    layer = nn.Linear(1, 1)
    layer.out_features, layer.in_features = weight.shape
    layer.weight, layer.bias = nn.Parameter(weight), nn.Parameter(bias)
    return layer


IMAGENET_MEAN = (123.675, 116.28, 103.53)
IMAGENET_STD = (58.395, 57.12, 57.375)
