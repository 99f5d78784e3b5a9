"""VGG-16, VGG-19 and networks of the same architecture with fewer channels (Simonyan and Zisserman, 2015)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from .network import (
    IMAGENET_MEAN,
    IMAGENET_STD,
    FeatureNetwork,
    Normalize,
    Padding,
    convolution,
    linear,
    plan_of,
    weight_and_bias,
)

_NAMED = re.compile(r"(conv([1-5])_?([1-4]))\.(?:weight|bias)")
_ORIGINAL_MEAN = (123.68, 116.779, 103.939)  # RGB
_POOLED = 7  # side of the classifier's input
_Convolutions = dict[tuple[int, int], str]  # (block, number in the block) → name of the layer in the checkpoint


def is_vgg(weights: Mapping[str, Any]) -> bool:
    """Return whether a checkpoint holds a VGG, judged by the names of its tensors."""
    return "features.0.weight" in weights or any(_NAMED.fullmatch(name) for name in weights)


def vgg(weights: Mapping[str, Tensor]) -> FeatureNetwork:
    """Build a VGG from a checkpoint; depth and numbers of channels follow from the tensors.

    Layers are ``conv1_1`` … ``conv5_4``, ``pool1`` … ``pool5`` and, if the checkpoint has them, ``fc6``, ``fc7`` and
    ``fc8``. The names of the tensors decide the input normalisation:

    - torchvision's names (``features.0.weight`` …) with a classifier: torchvision's mean and standard deviation.
    - torchvision's names with a classifier of NaN: the weights of Simonyan and Zisserman, 255 · RGB minus the mean.
    - ``conv0.weight``, a 1 × 1 convolution, before ``conv1_1.weight``: that convolution; padding is by reflection.
    - ``conv1_1.weight`` or ``conv11.weight`` …: 255 · BGR minus the mean.

    Args:
        weights: Tensors of the checkpoint, by name.

    Returns:
        The network, on the device of the weights.

    Raises:
        ValueError: A tensor is missing, or the shapes of consecutive layers do not fit.

    Example:
        >>> network = vgg({"conv1_1.weight": torch.rand(8, 3, 3, 3), "conv1_1.bias": torch.zeros(8)})
        >>> network(torch.rand(1, 3, 32, 32), ["conv1_1"])["conv1_1"].shape
        torch.Size([1, 8, 32, 32])
    """
    from_torchvision = "features.0.weight" in weights
    convolutions = _from_torchvision(weights) if from_torchvision else _from_names(weights)
    normalize, padding = _input_stage(weights)
    stages, width = _convolution_stages(weights, convolutions, padding)
    depth = len(convolutions) + 3
    if max(block for block, _ in convolutions) == 5 and max(place for block, place in convolutions if block == 5) > 1:
        stages["pool5"] = nn.MaxPool2d(2)
        if from_torchvision and _has_classifier(weights):
            stages |= _classifier(weights, width)
    elif max(convolutions) == (5, 1):
        depth = 19  # truncated after conv5_1, the last layer that style transfer uses
    return FeatureNetwork(f"VGG-{depth}", normalize, stages, plan_of(weights))


def _input_stage(weights: Mapping[str, Tensor]) -> tuple[nn.Module, Padding]:
    """Choose the input normalisation and the padding of the convolutions; see `vgg`."""
    if "features.0.weight" in weights:
        if _has_classifier(weights):
            return Normalize(IMAGENET_MEAN, IMAGENET_STD), "zeros"
        return Normalize(_ORIGINAL_MEAN), "zeros"
    if "conv0.weight" in weights:
        return convolution(weights["conv0.weight"], weights["conv0.bias"]), "reflect"
    return Normalize(_ORIGINAL_MEAN[::-1], bgr=True), "zeros"


def _convolution_stages(
    weights: Mapping[str, Tensor], convolutions: _Convolutions, padding: Padding
) -> tuple[dict[str, nn.Module], int]:
    """Make the convolutions and the pools between blocks; return them and the number of output channels."""
    stages: dict[str, nn.Module] = {}
    width = 3
    for (block, place), layer in sorted(convolutions.items()):
        name = f"conv{block}_{place}"
        if place > 1 and (block, place - 1) not in convolutions:
            raise ValueError(f"expected conv{block}_{place - 1} before {name}, got none")
        weight, bias = weight_and_bias(weights, layer, (width, 3, 3))
        if place == 1 and block > 1:
            stages[f"pool{block - 1}"] = nn.MaxPool2d(2)
        stages[name] = nn.Sequential(convolution(weight, bias, padding_mode=padding), nn.ReLU(inplace=True))
        width = len(bias)
    return stages, width


def _from_torchvision(weights: Mapping[str, Tensor]) -> _Convolutions:
    """Find the convolutions by torchvision's indices, which step by 2 (a ReLU between) or 3 (a pool) to a new block."""
    convolutions: _Convolutions = {}
    block, place, last = 1, 0, -2
    for index in sorted({int(name.split(".")[1]) for name in weights if re.fullmatch(r"features\.\d+\.\w+", name)}):
        if f"features.{index}.running_mean" in weights:
            raise ValueError("expected a VGG without batch normalisation, got one with it")
        if index - last == 3:
            block, place = block + 1, 0
        elif index - last != 2:
            raise ValueError(f"expected convolutions two or three apart, got features.{last} and features.{index}")
        place, last = place + 1, index
        convolutions[block, place] = f"features.{index}"
    return convolutions


def _from_names(weights: Mapping[str, Tensor]) -> _Convolutions:
    matches = filter(None, map(_NAMED.fullmatch, weights))
    return {(int(match[2]), int(match[3])): match[1] for match in matches}


def _has_classifier(weights: Mapping[str, Tensor]) -> bool:
    last = weights.get("classifier.6.bias")
    return last is not None and bool(torch.isfinite(last).all())


def _classifier(weights: Mapping[str, Tensor], width: int) -> dict[str, nn.Module]:
    """Make the three fully connected layers behind ``width`` channels."""
    layers = []
    inputs = width * _POOLED**2
    for index in (0, 3, 6):
        weight, bias = weight_and_bias(weights, f"classifier.{index}", (inputs,))
        layers.append(linear(weight, bias))
        inputs = len(bias)
    return {
        "fc6": nn.Sequential(nn.AdaptiveAvgPool2d(_POOLED), nn.Flatten(), layers[0], nn.ReLU(inplace=True)),
        "fc7": nn.Sequential(layers[1], nn.ReLU(inplace=True)),
        "fc8": layers[2],
    }
