"""Style transfer from a painting to a mesh (sections 4.2 and 5.2 of the paper): losses on its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ...base import validate
from ...optim import losses
from ..common.features import FeatureNetwork
from .objective import Deformation, Objective
from .options import STYLE_LAYERS, EditOptions

_LARGEST = 2048  # side of a square painting in pixels; a network needs some gigabytes for it
_MARGIN, _STRIDE = 16, 8  # pixels around objects in the window that the network sees, and step of its borders
_LEAST_SIDE, _MOST_ASPECT = 16, 16  # limits of a painting's shape, in pixels and as a ratio
_LIGHT = 0.15  # standard deviation of the brightness due to the light on an object, relative to the mean colour
_LEAST = 0.02  # least standard deviation, for paintings of one colour
_WITHIN = 2.5  # standard deviations around the mean that are free: nearly all colours of a painting
_ROUND = 0.1  # standard deviations over which the loss changes from flat to linear


@dataclass(frozen=True)
class StyleWeights:
    """Weights of the losses of `Style`. The weight of the style loss is 1.

    Attributes:
        content: Weight of the squared displacements of vertices, ≥ 0.
        bend: Weight of the bending loss, ≥ 0 (`Deformation.bend`).
        variation: Weight of the total variation of the images, ≥ 0.
        palette: Weight of the palette loss, ≥ 0. It penalises colours at more than 2.5 standard deviations from the
            mean of the painting (`Palette.excess`).

    Raises:
        TypeError, ValueError: In `Style`, a weight that is not a finite number ≥ 0.

    Example:
        >>> from neural_renderer.apps.edit import StyleWeights
        >>> StyleWeights(content=100.0)
        StyleWeights(content=100.0, bend=1.0, variation=0.5, palette=0.2)
    """

    content: float = 200.0
    bend: float = 1.0
    variation: float = 0.5
    palette: float = 0.2


PUBLISHED_STYLE = StyleWeights(content=2e9, bend=0.0, variation=1e7, palette=0.0)
"""Weights of the published code, for losses that are sums (``relative=False``)."""


class Style(Objective):
    """Objective of style transfer: the style loss, with regularisers for shape and colours.

    The losses are "style", whose value for each image `measure` returns, "content", "bend", "variation" and "palette".
    The background is the painting's mean colour.

    The style at a layer with features f_p [C] at pixels p is the masked Gram matrix
    ``G = Σ m_p f_p f_pᵀ / (C Σ m_p)``. The mask m is the object's silhouette, downsampled to the layer, so that the
    background does not count.

    With ``relative``, all losses are means that do not depend on the scale of the network, the mesh or the image size:
    ``|G − G*|² / |G*|²``, averaged over layers and views; the mean squared displacement of vertices; the mean total
    variation of the object's pixels. Without it, the losses are the sums of the published code; their weights suit the
    features of the original VGG-16 only.

    Args:
        network: Feature network with the layers.
        painting: [3 or 4, H, W] in [0, 1], RGB or RGBA. Transparent pixels do not count.
        size: Side of the square images of the object in pixels. The painting is resized to the same number of pixels;
            its aspect ratio stays.
        layers: Names of layers.
        weights: Weights of the other losses.
        painting_scale: Size of the painting relative to the images, > 0. 2 makes its strokes twice as large.
        relative: Whether losses are relative.

    Attributes:
        name: "style".
        plain: [3], mean colour of the painting, the initial colour of a mesh without colours.
        weights: Weights of the other losses. They may be replaced between two steps.

    Raises:
        TypeError, ValueError: A type or shape does not fit, the painting is too small or fully transparent, or a layer
            is unknown.

    Example:
        >>> from neural_renderer.apps.common.features import vgg
        >>> from neural_renderer.apps.edit import Style
        >>> network = vgg({"conv1_1.weight": torch.rand(8, 3, 3, 3), "conv1_1.bias": torch.zeros(8)})
        >>> style = Style(network, painting=torch.rand(3, 48, 64), size=64, layers=["conv1_1"])
        >>> style.background(2, torch.Generator()).shape
        torch.Size([2, 3])
        >>> style.measure(torch.rand(2, 3, 64, 64), torch.ones(2, 64, 64)).shape
        torch.Size([2])
    """

    name = "style"

    def __init__(
        self,
        network: FeatureNetwork,
        painting: Tensor,
        size: int = EditOptions.size,
        *,
        layers: Sequence[str] = STYLE_LAYERS,
        weights: StyleWeights = StyleWeights(),
        painting_scale: float = 1.0,
        relative: bool = True,
    ) -> None:
        self._network, self._layers = network, network.checked(layers)
        self.weights, self._relative = weights, relative
        for name, value in asdict(weights).items():
            validate.not_negative(name, value)
        side = size * validate.positive("painting_scale", painting_scale)
        if side > _LARGEST:
            most = _LARGEST / size
            raise ValueError(
                f"painting_scale: expected at most {most:.3g} for images of {size} pixels, got {painting_scale}"
            )
        painting, mask = _prepare(painting, side)
        with torch.no_grad():
            self._styles = {name: gram(f, mask) for name, f in network(painting, self._layers).items()}
        self._palette = Palette.of(painting, mask)
        self.plain = self._palette.mean

    def background(self, count: int, _: torch.Generator) -> Tensor:
        return self.plain.expand(count, 3)

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation) -> dict[str, Tensor]:
        inside = (masks == 1).to(images.dtype)
        variation, content = losses.total_variation(images, inside), shape.movement.square().sum()
        palette = (self._palette.excess(images.movedim(1, -1)) * inside).sum()
        if self._relative:
            pixels = inside.sum().clamp(min=1)
            variation, palette, content = variation / pixels, palette / pixels, content / len(shape.start)
        return {
            "style": self._distances(images, masks).mean(),
            "content": self.weights.content * content,
            "bend": self.weights.bend * shape.bend,
            "variation": self.weights.variation * variation,
            "palette": self.weights.palette * palette,
        }

    @torch.no_grad()
    def measure(self, images: Tensor, masks: Tensor) -> Tensor:
        return self._distances(images, masks)

    def _distances(self, images: Tensor, masks: Tensor) -> Tensor:
        """Compute the distances of Gram matrices from the painting's, summed over layers, [B]."""
        masks = masks.detach()
        window = _window(masks)
        images, masks = images[..., window[0], window[1]], masks[..., window[0], window[1]]
        total = torch.zeros(len(images), device=images.device)
        for name, features in self._network(images, self._layers).items():
            style = self._styles[name]
            distance = (gram(features, masks) - style).square().sum((1, 2))
            total = total + (distance / (style.square().sum() * len(self._layers)) if self._relative else distance)
        return total


def gram(features: Tensor, masks: Tensor) -> Tensor:
    """Compute Gram matrices [B, C, C] of features [B, C, h, w], weighted by masks [B, H, W] downsampled to h × w."""
    count, channels, height, width = features.shape
    masks = F.adaptive_avg_pool2d(masks[:, None], (height, width)).reshape(count, 1, -1)
    flat = features.reshape(count, channels, -1)
    area = masks.sum(2, keepdim=True).clamp(min=1e-6)
    return (flat * (masks / (channels * area))) @ flat.transpose(1, 2)


def _window(masks: Tensor) -> tuple[slice, slice]:
    """Find the rows and columns that contain all objects, with a margin; borders are multiples of the pools' stride."""
    found = []
    for axis in (2, 1):
        covered = torch.nonzero(masks.amax((0, axis)) > 0).flatten()
        last = masks.shape[3 - axis]
        low, high = (int(covered[0]), int(covered[-1]) + 1) if len(covered) else (0, last)
        start, stop = max(low - _MARGIN, 0) // _STRIDE, -(-(high + _MARGIN) // _STRIDE)
        found.append(slice(start * _STRIDE, min(stop * _STRIDE, last)))
    return found[0], found[1]


def _prepare(painting: Tensor, side: float) -> tuple[Tensor, Tensor]:
    """Resize a painting to about side² pixels: RGB [1, 3, h, w] and mask [1, h, w]."""
    channels = getattr(painting, "shape", (3,))[0] if getattr(painting, "ndim", 3) == 3 else 3
    validate.floating("painting", painting, (4 if channels == 4 else 3, "H", "W"))
    height, width = painting.shape[1:]
    if min(height, width) < _LEAST_SIDE or max(height, width) > _MOST_ASPECT * min(height, width):
        raise ValueError(
            f"painting: expected sides of at least {_LEAST_SIDE} pixels and an aspect ratio of at most {_MOST_ASPECT}, "
            f"got {width} x {height}"
        )
    mask = painting[3:] if channels == 4 else torch.ones_like(painting[:1])
    if float(mask.max()) < 0.5:
        raise ValueError("painting: expected opaque pixels, got a picture that is fully transparent")
    scale = side / math.sqrt(height * width)
    size = (max(round(height * scale), _LEAST_SIDE), max(round(width * scale), _LEAST_SIDE))
    both = torch.cat((painting[:3] * mask, mask))[None]
    both = F.interpolate(both, size, mode="bilinear", antialias=True, align_corners=False)
    mask = both[:, 3].clamp(0, 1)
    return (both[:, :3] / mask[:, None].clamp(min=1e-3)).clamp(0, 1), mask


@dataclass(frozen=True, eq=False)
class Palette:
    """Mean and covariance of a painting's colours, widened by the light on an object.

    The Gram matrices of a narrow network do not distinguish every colour from a mixture of others, such as cream from
    yellow next to pink. Colours outside the ellipsoid of the painting's colours are therefore penalised; those inside
    are free.
    """

    mean: Tensor  # [3], RGB
    whiten: Tensor  # [3, 3], maps a difference from the mean to standard deviations

    @classmethod
    def of(cls, painting: Tensor, mask: Tensor) -> Palette:
        """Measure the colours of a painting [1, 3, h, w] in [0, 1], weighted by its mask [1, h, w] in [0, 1]."""
        colors, weights = painting[0].flatten(1).T, mask.flatten() / mask.sum().clamp(min=1e-6)
        mean = weights @ colors
        offset = colors - mean
        covariance = offset.T @ (offset * weights[:, None]) + _LIGHT**2 * torch.outer(mean, mean)
        variance, axes = torch.linalg.eigh(covariance)
        # The least variance is added, not a lower bound, so that distances depend smoothly on the painting.
        return cls(mean, axes / (variance.clamp(min=0) + _LEAST**2).sqrt())

    def excess(self, colors: Tensor) -> Tensor:
        """Compute by how many standard deviations colours [..., 3] are outside the free ellipsoid, [...]; 0 inside.

        The loss is linear far outside: squares would have such large gradients for distant initial colours that Adam's
        steps would stay small for a long time.
        """
        distance = ((colors - self.mean) @ self.whiten).square().sum(-1)
        beyond = distance.clamp(min=_WITHIN**2).sqrt() - _WITHIN
        return (beyond.square() + _ROUND**2).sqrt() - _ROUND
