"""From images to 512 features: the paper's encoder, a lighter one, and one that others have trained."""

from __future__ import annotations

import math
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ....features import FeatureNetwork

FEATURES = 512

EncoderName = Literal["paper", "light", "features"]


class PaperEncoder(nn.Sequential):
    """The encoder of the published code: three 5×5 convolutions of stride 2 and three dense layers, 19 M weights.

    Takes [B, 4, 64, 64] in [0, 1], returns [B, 512]; ReLU after every layer, no normalisation.
    """

    def __init__(self) -> None:
        layers: list[nn.Module] = []
        for inward, outward in ((4, 64), (64, 128), (128, 256)):
            layers += [nn.Conv2d(inward, outward, 5, stride=2, padding=2), nn.ReLU()]
        layers.append(nn.Flatten())
        for inward, outward in ((16384, 1024), (1024, 1024), (1024, FEATURES)):
            layers += [nn.Linear(inward, outward), nn.ReLU()]
        super().__init__(*layers)
        self.apply(published_start)


class LightEncoder(nn.Sequential):
    """A 7×7 convolution of stride 4, two residual blocks of stride 2 and a dense layer: 1.3 M weights of width 32.

    Takes [B, 4, 64, 64] in [0, 1], returns [B, 512]. Groups, not batches, are normalised: an image's features do not
    depend on what else is in its batch, nor on how many processes share the batch.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__(
            _Centred(),
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
    """What a network for recognition sees in an image, and one dense layer that learns what to make of it.

    Takes [B, 4, 64, 64] in [0, 1], returns [B, 512]. The image is enlarged and shown on white; the layer, one of 1/16
    of its size, is taken at 4×4 places. The network stays as it is: with few objects to learn from it knows more of
    what things are, and of how they are turned, than they can teach.
    """

    SIZE = 112
    LAYERS = ("inception_4c", "conv4_3")

    def __init__(self, features: FeatureNetwork) -> None:
        super().__init__()
        self.layer = next((name for name in self.LAYERS if name in features.layers), "")
        if not self.layer:
            raise ValueError(
                f"features: expected a network with {' or '.join(self.LAYERS)}, got {features.name} without"
            )
        self.features = features.until(self.layer)
        with torch.no_grad():
            channels = self._seen(torch.zeros(1, 4, 64, 64)).shape[1]
        self.learned = nn.Sequential(nn.Flatten(), nn.Linear(16 * channels, FEATURES), nn.SiLU())

    def forward(self, images: Tensor) -> Tensor:
        with torch.no_grad():
            seen = self._seen(images)
        return self.learned(seen)

    def _seen(self, images: Tensor) -> Tensor:
        found = self.features(on_white(images, self.SIZE), [self.layer])[self.layer]
        seen = F.adaptive_avg_pool2d(found, 4)
        return F.group_norm(seen, math.gcd(seen.shape[1], 32))


def on_white(images: Tensor, size: int) -> Tensor:
    """Images [B, 4, H, W] in [0, 1] as networks for recognition know them: [B, 3, size, size], on white."""
    shown = images[:, :3] * images[:, 3:] + 1 - images[:, 3:]
    return F.interpolate(shown, (size, size), mode="bilinear", align_corners=False)


class _Centred(nn.Module):
    """[0, 1] to [-1, 1], with what lies outside of the object black whatever the file holds there."""

    def forward(self, images: Tensor) -> Tensor:
        return torch.cat((images[:, :3] * images[:, 3:], images[:, 3:]), 1) * 2 - 1


class _Block(nn.Module):
    """Two 3×3 convolutions, the first of stride 2, beside a mean of 2×2 pixels."""

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
    """The encoder of this name: ``width`` is the number of channels that "light" begins with.

    Raises ValueError if "features" is to be made without them, or with a network that lacks the layer.
    """
    if name != "features":
        return PaperEncoder() if name == "paper" else LightEncoder(width)
    if features is None:
        raise ValueError("features: expected a network for the encoder to look at images with, got None")
    return FeatureEncoder(features)


def published_start(layer: nn.Module) -> None:
    """Weights as the published code draws them: normal, of variance 1 / fan-in; biases 0."""
    if isinstance(layer, (nn.Conv2d, nn.Linear)):
        fan_in = layer.weight[0].numel()
        nn.init.normal_(layer.weight, std=1 / math.sqrt(fan_in))
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)
