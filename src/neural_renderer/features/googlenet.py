"""GoogLeNet (Szegedy et al., 2015): the one of Caffe's model zoo ("BVLC"), and torchvision's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from .network import FeatureNetwork, Normalise, convolution, linear, plan_of

_BLOCKS = ("3a", "3b", "4a", "4b", "4c", "4d", "4e", "5a", "5b")
_BRANCHES = ("1x1", "3x3_reduce", "3x3", "5x5_reduce", "5x5", "pool_proj")
# torchvision's name of each convolution, and ours, which is Caffe's with a dot for the slash.
_TORCHVISION = {"conv1": "conv1.7x7_s2", "conv2": "conv2.3x3_reduce", "conv3": "conv2.3x3"} | {
    f"inception{block}.{theirs}": f"inception_{block}.{ours}"
    for block in _BLOCKS
    for theirs, ours in zip(
        ("branch1", "branch2.0", "branch2.1", "branch3.0", "branch3.1", "branch4.1"), _BRANCHES, strict=True
    )
}
_ALPHA = 1e-4 / 5  # of Caffe's local response normalisation, for a sum over five channels
_EPSILON = 1e-3  # of torchvision's batch normalisation


def is_googlenet(weights: Mapping[str, Any]) -> bool:
    """Whether these are the weights of a GoogLeNet, by their names."""
    return any(name.startswith(("inception3a.", "inception_3a.")) for name in weights)


def googlenet(weights: Mapping[str, Tensor]) -> FeatureNetwork:
    """The network of a checkpoint, in either form.

    Caffe's has local response normalisation, torchvision's batch normalisation, which goes into the convolutions here,
    a 3 × 3 convolution in place of the 5 × 5, and a smaller fourth pool. Layers are ``conv1``, ``pool1``,
    ``conv2_reduce``, ``conv2``, ``pool2``, ``inception_3a`` … ``inception_5b`` with ``pool3`` and ``pool4`` between
    them, ``pool5`` [B, 1024] and ``classifier`` [B, 1000], the last one before its softmax.

    Raises ValueError for tensors that are missing or do not follow one another.
    """
    torchvisions = "conv1.conv.weight" in weights
    layers = _Layers(_folded(weights) if torchvisions else dict(weights))
    norm: list[nn.Module] = [] if torchvisions else [LocalResponse()]
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
            stages["pool4"] = nn.MaxPool2d(2 if torchvisions else 3, 2, ceil_mode=True)
    stages["pool5"] = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten())
    stages["classifier"] = linear(*layers.pair("loss3.classifier", (layers.width,)))
    normalise = Normalise((127.5,) * 3, (127.5,) * 3) if torchvisions else Normalise((104, 117, 123), bgr=True)
    return FeatureNetwork("GoogLeNet", normalise, stages, plan_of(weights))


class LocalResponse(nn.Module):
    """Local response normalisation: x / (1 + 1e-4 · mean of x² over the 5 channels around)^0.75."""

    def forward(self, values: Tensor) -> Tensor:
        """[B, C, H, W]."""
        return _LocalResponse.apply(values)


class _LocalResponse(torch.autograd.Function):
    """By hand, because autograd would keep and copy each of the additions: a third of the time."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        scale = _five(values.square()).mul_(_ALPHA).add_(1)
        root = scale.sqrt()
        factor = (root * root.sqrt()).reciprocal_()
        ctx.save_for_backward(values, scale, factor)
        return values * factor

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        values, scale, factor = ctx.saved_tensors
        own = gradients[0] * factor
        around = _five((own * values).div_(scale))
        return own.addcmul_(values, around, value=-1.5 * _ALPHA)


def _five(values: Tensor) -> Tensor:
    """Sums over the five channels around each; differences of running sums would lose digits."""
    total = values.clone()
    for shift in (1, 2):
        total[:, shift:] += values[:, :-shift]
        total[:, :-shift] += values[:, shift:]
    return total


class Inception(nn.Module):
    """Four branches side by side, their channels one after the other."""

    def __init__(self, layers: _Layers, name: str) -> None:
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
        """[B, C, H, W] → [B, C', H, W]."""
        parts = self._parts
        three, five = parts["3x3"](parts["3x3_reduce"](values)), parts["5x5"](parts["5x5_reduce"](values))
        return torch.cat((parts["1x1"](values), three, five, parts["pool_proj"](self._pool(values))), 1)


class _Layers:
    """Makes layers of a checkpoint, each held to the width of the one before."""

    def __init__(self, weights: dict[str, Tensor]) -> None:
        self._weights = weights
        self.width = 3

    def convolution(self, name: str, inputs: int | None = None, stride: int = 1) -> nn.Module:
        kernel = self._weights.get(f"{name}.weight")
        side = kernel.shape[-1] if kernel is not None and kernel.dim() == 4 else 1
        weight, bias = self.pair(name, (self.width if inputs is None else inputs, side, side))
        self.width = len(bias)
        return nn.Sequential(convolution(weight, bias, stride), nn.ReLU(inplace=True))

    def pair(self, name: str, shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
        weight, bias = self._weights.get(f"{name}.weight"), self._weights.get(f"{name}.bias")
        if weight is None or bias is None:
            raise ValueError(f"expected a weight and a bias of {name}, which are missing")
        if tuple(weight.shape[1:]) != shape or bias.shape != weight.shape[:1]:
            raise ValueError(
                f"expected {name}.weight of shape [·, {', '.join(map(str, shape))}], got {list(weight.shape)}"
            )
        return weight, bias


def _folded(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """torchvision's weights under our names, with batch normalisation as part of the convolutions."""
    found: dict[str, Tensor] = {}
    for theirs, ours in _TORCHVISION.items():
        names = ("conv.weight", "bn.weight", "bn.bias", "bn.running_mean", "bn.running_var")
        parts = [weights.get(f"{theirs}.{name}") for name in names]
        if any(part is None for part in parts):
            raise ValueError(f"expected {theirs} with its batch normalisation, which is missing")
        kernel, gain, bias, mean, variance = (part.double() for part in parts)  # type: ignore[union-attr]
        gain = gain / (variance + _EPSILON).sqrt()
        found[f"{ours}.weight"] = (kernel * gain[:, None, None, None]).float()
        found[f"{ours}.bias"] = (bias - mean * gain).float()
    found |= {
        f"loss3.classifier.{part}": weights[f"fc.{part}"] for part in ("weight", "bias") if f"fc.{part}" in weights
    }
    return found
