"""VGG-16, VGG-19 and narrower networks of the same plan (Simonyan and Zisserman, 2015)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from .network import IMAGENET_MEAN, IMAGENET_STD, FeatureNetwork, Normalise, Padding, convolution, linear, plan_of

_NAMED = re.compile(r"conv([1-5])_?([1-4])\.(weight|bias)")
_ORIGINAL_MEAN = (123.68, 116.779, 103.939)  # of red, green, blue
_Plan = dict[tuple[int, int], dict[str, Tensor]]


def is_vgg(weights: Mapping[str, Any]) -> bool:
    """Whether these are the weights of a VGG, by their names."""
    return "features.0.weight" in weights or any(_NAMED.fullmatch(name) for name in weights)


def vgg(weights: Mapping[str, Tensor]) -> FeatureNetwork:
    """The network of a checkpoint; its depth and widths are read from it.

    Known are torchvision's names, ``features.0.weight`` …, and ``conv1_1.weight`` or ``conv11.weight`` …. Layers are
    ``conv1_1`` … ``conv5_4``, ``pool1`` … ``pool5`` and, where the checkpoint has them, ``fc6``, ``fc7``, ``fc8``.

    torchvision's own checkpoints want images normalised in its way; those whose classifier is missing (NaN) are
    Simonyan and Zisserman's, which want grey levels without their mean, as do checkpoints with the other names (in the
    order BGR) unless they begin with a 1 × 1 convolution ``conv0``: that one takes [0, 1], and pads by reflection.

    Raises ValueError for tensors that do not follow one another.
    """
    torchvisions = "features.0.weight" in weights
    plan = _from_torchvision(weights) if torchvisions else _from_names(weights)
    mode: Padding = "zeros"
    if torchvisions and _is_complete(weights):
        normalise: nn.Module = Normalise(IMAGENET_MEAN, IMAGENET_STD)
    elif torchvisions:
        normalise = Normalise(_ORIGINAL_MEAN)
    elif "conv0.weight" in weights:
        normalise, mode = convolution(weights["conv0.weight"], weights["conv0.bias"]), "reflect"
    else:
        normalise = Normalise(_ORIGINAL_MEAN[::-1], bgr=True)
    stages: dict[str, nn.Module] = {}
    width = 3
    for (block, place), layer in sorted(plan.items()):
        name = f"conv{block}_{place}"
        if set(layer) != {"weight", "bias"} or ((block, place - 1) not in plan and place > 1):
            raise ValueError(f"expected a weight and a bias for each convolution, up to {name}")
        shape = tuple(layer["weight"].shape)
        if len(shape) != 4 or shape[1:] != (width, 3, 3) or layer["bias"].shape != shape[:1]:
            raise ValueError(f"expected {name}.weight of shape [·, {width}, 3, 3], got {list(shape)}")
        if place == 1 and block > 1:
            stages[f"pool{block - 1}"] = nn.MaxPool2d(2)
        stages[name] = nn.Sequential(
            convolution(layer["weight"], layer["bias"], padding_mode=mode), nn.ReLU(inplace=True)
        )
        width = shape[0]
    depth = len(plan) + 3
    if max(block for block, _ in plan) == 5 and max(place for block, place in plan if block == 5) > 1:
        stages["pool5"] = nn.MaxPool2d(2)
        if torchvisions and _is_complete(weights):
            stages |= _classifier(weights, width)
    elif max(plan) == (5, 1):
        depth = 19  # the part of VGG-19 up to conv5_1 that style transfer uses
    return FeatureNetwork(f"VGG-{depth}", normalise, stages, plan_of(weights))


def _from_torchvision(weights: Mapping[str, Tensor]) -> _Plan:
    """The convolutions are numbered with the ReLUs and pools between them: two on in a block, three on to the next."""
    plan: _Plan = {}
    block, place, last = 1, 0, -2
    for index in sorted({int(name.split(".")[1]) for name in weights if re.fullmatch(r"features\.\d+\.\w+", name)}):
        if f"features.{index}.running_mean" in weights:
            raise ValueError("expected a VGG without batch normalisation, got one with it")
        if index - last == 3:
            block, place = block + 1, 0
        elif index - last != 2:
            raise ValueError(f"expected convolutions two or three apart, got features.{last} and features.{index}")
        place, last = place + 1, index
        parts = {part: weights.get(f"features.{index}.{part}") for part in ("weight", "bias")}
        plan[block, place] = {part: value for part, value in parts.items() if value is not None}
    return plan


def _from_names(weights: Mapping[str, Tensor]) -> _Plan:
    plan: _Plan = {}
    for name, value in weights.items():
        if match := _NAMED.fullmatch(name):
            plan.setdefault((int(match[1]), int(match[2])), {})[match[3]] = value
    return plan


def _is_complete(weights: Mapping[str, Tensor]) -> bool:
    """Whether torchvision's checkpoint has a classifier that can be used."""
    last = weights.get("classifier.6.bias")
    return last is not None and bool(torch.isfinite(last).all())


def _classifier(weights: Mapping[str, Tensor], width: int) -> dict[str, nn.Module]:
    layers = []
    inputs = width * 49
    for index in (0, 3, 6):
        weight, bias = (weights.get(f"classifier.{index}.{part}") for part in ("weight", "bias"))
        if weight is None or bias is None or weight.shape[1:] != (inputs,) or bias.shape != weight.shape[:1]:
            raise ValueError(f"expected classifier.{index} with {inputs} inputs")
        layers.append(linear(weight, bias))
        inputs = len(bias)
    return {
        "fc6": nn.Sequential(nn.AdaptiveAvgPool2d(7), nn.Flatten(), layers[0], nn.ReLU(inplace=True)),
        "fc7": nn.Sequential(layers[1], nn.ReLU(inplace=True)),
        "fc8": layers[2],
    }
