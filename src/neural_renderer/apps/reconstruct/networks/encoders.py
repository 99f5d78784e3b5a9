"""Encoders: images to 512 features."""

from __future__ import annotations

import math
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...common.features import FeatureNetwork

FEATURES = 512

EncoderName = Literal["paper", "light", "features"]


class PaperEncoder(nn.Sequential):
    """Encoder of the published code: three 5×5 convolutions of stride 2, three dense layers; 19 M weights.

    Maps images [B, 4, 64, 64] in [0, 1] to [B, 512]. A ReLU follows each layer; there is no normalisation.
    """

    def __init__(self) -> None:
        layers: list[nn.Module] = []
        for inward, outward in ((4, 64), (64, 128), (128, 256)):
            layers += [nn.Conv2d(inward, outward, 5, stride=2, padding=2), nn.ReLU()]
        layers.append(nn.Flatten())
        for inward, outward in ((16384, 1024), (1024, 1024), (1024, FEATURES)):
            layers += [nn.Linear(inward, outward), nn.ReLU()]
        super().__init__(*layers)
        self.apply(published_init)


class LightEncoder(nn.Sequential):
    """Small residual encoder: a 7×7 convolution of stride 4, two blocks of stride 2, a dense layer.

    Maps images [B, 4, 64, 64] in [0, 1] to [B, 512]. It has 1.3 M weights for ``width`` 32. Group normalisation keeps
    the features of an image independent of the rest of the batch and of the number of processes.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__(
            _ToSigned(),
            nn.Conv2d(4, width, 7, stride=4, padding=3, bias=False),
            nn.GroupNorm(8, width),
            nn.ReLU(),
            _Block(width, 2 * width),
            _Block(2 * width, 4 * width),
            nn.Flatten(),
            nn.Linear(16 * 4 * width, FEATURES),
            nn.SiLU(),
        )


class FeatureEncoder(nn.Module):
    """Frozen features of a recognition network, followed by a learned dense layer.

    Maps images [B, 4, 64, 64] in [0, 1] to [B, 512]. Images are enlarged to 112 pixels on white, and the activations
    are pooled to 4×4. With few training objects, pretrained features generalise better than learned ones.
    """

    SIZE = 112
    LAYERS = ("inception_4c", "conv4_3")

    def __init__(self, features: FeatureNetwork) -> None:
        super().__init__()
        self.layer = next((name for name in self.LAYERS if name in features.layers), "")
        if not self.layer:
            raise ValueError(
                f"features: expected a network with {' or '.join(self.LAYERS)}, got {features.name} without them"
            )
        self.features = features.until(self.layer)
        with torch.no_grad():
            channels = self._pooled(torch.zeros(1, 4, 64, 64)).shape[1]
        self.learned = nn.Sequential(nn.Flatten(), nn.Linear(16 * channels, FEATURES), nn.SiLU())

    def forward(self, images: Tensor) -> Tensor:
        """Encode images [B, 4, 64, 64] to [B, 512]."""
        with torch.no_grad():
            pooled = self._pooled(images)
        return self.learned(pooled)

    def _pooled(self, images: Tensor) -> Tensor:
        """Compute normalised activations [B, C, 4, 4] of images."""
        activations = self.features(on_white(images, self.SIZE), [self.layer])[self.layer]
        pooled = F.adaptive_avg_pool2d(activations, 4)
        return F.group_norm(pooled, math.gcd(pooled.shape[1], 32))


def on_white(images: Tensor, size: int) -> Tensor:
    """Composite RGBA images [B, 4, H, W] in [0, 1] on white and resize them: [B, 3, size, size]."""
    rgb = images[:, :3] * images[:, 3:] + 1 - images[:, 3:]
    return F.interpolate(rgb, (size, size), mode="bilinear", align_corners=False)


class _ToSigned(nn.Module):
    """Maps images from [0, 1] to [-1, 1]; transparent pixels become black."""

    def forward(self, images: Tensor) -> Tensor:
        return torch.cat((images[:, :3] * images[:, 3:], images[:, 3:]), 1) * 2 - 1


class _Block(nn.Module):
    """Residual block: two 3×3 convolutions, the first of stride 2, and a shortcut of mean-pooled pixels."""

    def __init__(self, inward: int, outward: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inward, outward, 3, stride=2, padding=1, bias=False)
        self.second = nn.Conv2d(outward, outward, 3, padding=1, bias=False)
        self.short = nn.Conv2d(inward, outward, 1, bias=False)
        self.norms = nn.ModuleList(nn.GroupNorm(8, outward) for _ in range(2))
        self.activation = nn.ReLU()

    def forward(self, value: Tensor) -> Tensor:
        deep = self.norms[1](self.second(self.activation(self.norms[0](self.first(value)))))
        return self.activation(deep + self.short(nn.functional.avg_pool2d(value, 2)))


def make_encoder(name: EncoderName, width: int = 32, features: FeatureNetwork | None = None) -> nn.Module:
    """Make the encoder "paper", "light", with ``width`` channels at its first layer, or "features", of a network."""
    if name != "features":
        return PaperEncoder() if name == "paper" else LightEncoder(width)
    if features is None:
        raise ValueError('features: expected a network for the encoder "features", got None')
    return FeatureEncoder(features)


def published_init(layer: nn.Module) -> None:
    """Initialise a layer like the published code: normal weights of variance 1 / fan-in, zero biases."""
    if isinstance(layer, (nn.Conv2d, nn.Linear)):
        fan_in = layer.weight[0].numel()
        nn.init.normal_(layer.weight, std=1 / math.sqrt(fan_in))
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)
