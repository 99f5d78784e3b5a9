"""GoogLeNet (Szegedy et al., 2015): the version of Caffe's model zoo ("BVLC") and torchvision's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from .network import FeatureNetwork, Normalize, convolution, linear, plan_of, weight_and_bias

_BLOCKS = ("3a", "3b", "4a", "4b", "4c", "4d", "4e", "5a", "5b")
_BRANCHES = ("1x1", "3x3_reduce", "3x3", "5x5_reduce", "5x5", "pool_proj")
# torchvision's name of each convolution → ours: Caffe's, with a dot in place of the slash.
_TORCHVISION = {"conv1": "conv1.7x7_s2", "conv2": "conv2.3x3_reduce", "conv3": "conv2.3x3"} | {
    f"inception{block}.{theirs}": f"inception_{block}.{ours}"
    for block in _BLOCKS
    for theirs, ours in zip(
        ("branch1", "branch2.0", "branch2.1", "branch3.0", "branch3.1", "branch4.1"), _BRANCHES, strict=True
    )
}
_ALPHA = 1e-4 / 5  # α of Caffe's local response normalisation, for a sum over five channels
_EPSILON = 1e-3  # ε of torchvision's batch normalisation
_HALF_RANGE = (127.5,) * 3  # mean and standard deviation of torchvision's input
_CAFFE_MEAN = (104, 117, 123)  # BGR


def is_googlenet(weights: Mapping[str, Any]) -> bool:
    """Return whether a checkpoint holds a GoogLeNet, judged by the names of its tensors."""
    return any(name.startswith(("inception3a.", "inception_3a.")) for name in weights)


def googlenet(weights: Mapping[str, Tensor]) -> FeatureNetwork:
    """Build a GoogLeNet from a checkpoint of Caffe or torchvision.

    Caffe's version has local response normalisation. torchvision's has batch normalisation, which is folded into the
    convolutions, 3 × 3 convolutions in place of 5 × 5, and a smaller fourth pool. Layers are ``conv1``, ``pool1``,
    ``conv2_reduce``, ``conv2``, ``pool2``, ``inception_3a`` … ``inception_5b`` with ``pool3`` and ``pool4`` between
    them, ``pool5`` [B, 1024] and ``classifier`` [B, 1000] (before the softmax).

    Args:
        weights: Tensors of the checkpoint, by name.

    Returns:
        The network, on the device of the weights.

    Raises:
        ValueError: A tensor is missing, or the shapes of consecutive layers do not fit.

    Example:
        >>> weights = torch.load("googlenet-1378be20.pth")  # doctest: +SKIP
        >>> googlenet(weights).layers[:3]  # doctest: +SKIP
        ('conv1', 'pool1', 'conv2_reduce')
    """
    from_torchvision = "conv1.conv.weight" in weights
    tensors = _fold_batch_norm(weights) if from_torchvision else weights
    layers = _LayerBuilder(tensors)
    norm: list[nn.Module] = [] if from_torchvision else [LocalResponse()]
    stages: dict[str, nn.Module] = {
        "conv1": layers.convolution("conv1.7x7_s2", 3, stride=2),
        "pool1": nn.Sequential(nn.MaxPool2d(3, 2, ceil_mode=True), *norm),
        "conv2_reduce": layers.convolution("conv2.3x3_reduce"),
        "conv2": nn.Sequential(layers.convolution("conv2.3x3"), *norm),
        "pool2": nn.MaxPool2d(3, 2, ceil_mode=True),
    }
    for block in _BLOCKS:
        stages[f"inception_{block}"] = Inception(layers, f"inception_{block}")
        if block == "3b":
            stages["pool3"] = nn.MaxPool2d(3, 2, ceil_mode=True)
        if block == "4e":
            stages["pool4"] = nn.MaxPool2d(2 if from_torchvision else 3, 2, ceil_mode=True)
    stages["pool5"] = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten())
    stages["classifier"] = linear(*weight_and_bias(tensors, "loss3.classifier", (layers.width,)))
    normalize = Normalize(_HALF_RANGE, _HALF_RANGE) if from_torchvision else Normalize(_CAFFE_MEAN, bgr=True)
    return FeatureNetwork("GoogLeNet", normalize, stages, plan_of(weights))


class LocalResponse(nn.Module):
    """Local response normalisation x / (1 + 1e-4 · mean of x² over 5 neighbouring channels)^0.75."""

    def forward(self, values: Tensor) -> Tensor:
        """Normalise values [B, C, H, W]."""
        return _LocalResponse.apply(values)  # type: ignore[no-untyped-call]


class _LocalResponse(torch.autograd.Function):
    """Hand-written gradient of `LocalResponse`: autograd would store each addition and take a third of the time."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        scale = _sum_of_five_channels(values.square()).mul_(_ALPHA).add_(1)
        root = scale.sqrt()
        factor = (root * root.sqrt()).reciprocal_()
        ctx.save_for_backward(values, scale, factor)
        return values * factor

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        values, scale, factor = ctx.saved_tensors
        grad = gradients[0] * factor
        around = _sum_of_five_channels((grad * values).div_(scale))
        return grad.addcmul_(values, around, value=-1.5 * _ALPHA)


def _sum_of_five_channels(values: Tensor) -> Tensor:
    """Sum each channel with its four nearest ones. Differences of a cumulative sum would lose digits."""
    total = values.clone()
    for shift in (1, 2):
        total[:, shift:] += values[:, :-shift]
        total[:, :-shift] += values[:, shift:]
    return total


class Inception(nn.Module):
    """Inception block: four parallel branches, concatenated along channels."""

    def __init__(self, layers: _LayerBuilder, name: str) -> None:
        super().__init__()
        width = layers.width
        parts: dict[str, nn.Module] = {}
        out = 0
        for branch in _BRANCHES:
            reduced = branch in ("3x3", "5x5")
            parts[branch] = layers.convolution(f"{name}.{branch}", layers.width if reduced else width)
            out += 0 if branch.endswith("_reduce") else layers.width
        layers.width = out
        self._parts = nn.ModuleDict(parts)
        self._pool = nn.MaxPool2d(3, 1, padding=1)

    def forward(self, values: Tensor) -> Tensor:
        """Map values [B, C, H, W] to [B, C', H, W]."""
        parts = self._parts
        three, five = parts["3x3"](parts["3x3_reduce"](values)), parts["5x5"](parts["5x5_reduce"](values))
        return torch.cat((parts["1x1"](values), three, five, parts["pool_proj"](self._pool(values))), 1)


class _LayerBuilder:
    """Makes layers from a checkpoint and checks that each fits the number of channels before it."""

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        self._weights = weights
        self.width = 3  # channels after the layers made so far

    def convolution(self, name: str, inputs: int | None = None, stride: int = 1) -> nn.Module:
        """Make a convolution with ReLU; ``inputs`` is its number of input channels, by default ``width``."""
        kernel = self._weights.get(f"{name}.weight")
        side = kernel.shape[-1] if kernel is not None and kernel.dim() == 4 else 1
        shape = (self.width if inputs is None else inputs, side, side)
        weight, bias = weight_and_bias(self._weights, name, shape)
        self.width = len(bias)
        return nn.Sequential(convolution(weight, bias, stride), nn.ReLU(inplace=True))


def _fold_batch_norm(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Fold torchvision's batch normalisation into the convolutions, and rename the tensors to our names."""
    found: dict[str, Tensor] = {}
    for theirs, ours in _TORCHVISION.items():
        names = ("conv.weight", "bn.weight", "bn.bias", "bn.running_mean", "bn.running_var")
        parts = [weights.get(f"{theirs}.{name}") for name in names]
        if any(part is None for part in parts):
            raise ValueError(f"expected {theirs} with batch normalisation, got some of its tensors only")
        kernel, gain, bias, mean, variance = (part.double() for part in parts)  # type: ignore[union-attr]
        gain = gain / (variance + _EPSILON).sqrt()
        found[f"{ours}.weight"] = (kernel * gain[:, None, None, None]).float()
        found[f"{ours}.bias"] = (bias - mean * gain).float()
    found |= {
        f"loss3.classifier.{part}": weights[f"fc.{part}"] for part in ("weight", "bias") if f"fc.{part}" in weights
    }
    return found
