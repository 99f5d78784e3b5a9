"""Style transfer from a painting to a mesh (sections 4.2 and 5.2 of the paper), as losses on its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import losses, validate
from ...features import FeatureNetwork
from .deformation import Deformation
from .palette import Palette

STYLE_LAYERS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3")
"""The paper's, whose conv2_3 does not exist: the published code takes conv2_2."""
_LARGEST = 2048  # pixels along the side of a square painting, which take a network some gigabytes
_MARGIN = 16  # pixels around the objects that the network sees too


@dataclass(frozen=True)
class StyleWeights:
    """How much each loss counts beside the style loss, whose weight is 1."""

    content: float = 200.0
    """Squared distance of the vertices from where they began."""
    bend: float = 1.0
    """Squared difference of the movements of an edge's ends, in lengths of that edge."""
    variation: float = 0.5
    """Squared difference of neighbouring pixels' colours."""
    palette: float = 0.2
    """Distance of colours from the painting's own, where they are beyond 2.5 standard deviations of them."""


PUBLISHED_STYLE = StyleWeights(content=2e9, bend=0.0, variation=1e7, palette=0.0)
"""The published code's, for sums (``relative=False``)."""


class Style:
    """The style loss of images of an object against a painting, with what keeps object and colours together.

    The style of an image at a layer with features f_p [C] at its pixels p is the Gram matrix
    ``G = Σ m_p f_p f_pᵀ / (C Σ m_p)``, where m is the object's mask, averaged down to the layer: what is behind the
    object has no part in it.

    With ``relative`` all losses are means, which no network's scale, mesh or image size changes: for each layer
    ``|G − G*|² / |G*|²``, averaged over layers and views; the mean over the vertices of their squared movement; the
    mean of the squared differences over the object's pixels. Without it they are the sums of the published code, for
    which its weights are made; they belong to features of the original VGG-16.

    Args:
        network: with the layers.
        painting: [3 or 4, H, W] in [0, 1]; what is transparent has no part in the style.
        size: side of the square images that will be compared, in pixels. The painting gets as many pixels, its
            proportions kept.
        layers: names of the network's layers.
        weights: of the other losses.
        painting_scale: how large the painting is, relative to the images: 2 makes its strokes twice as large.
        relative: see above.

    Attributes:
        plain: [3], the painting's mean colour.

    Raises:
        TypeError, ValueError: another shape, a painting that is too small or wholly transparent, an unknown layer.
    """

    name = "style"

    def __init__(
        self,
        network: FeatureNetwork,
        painting: Tensor,
        size: int = 224,
        *,
        layers: Sequence[str] = STYLE_LAYERS,
        weights: StyleWeights = StyleWeights(),
        painting_scale: float = 1.0,
        relative: bool = True,
    ) -> None:
        self._network, self._layers = network, network.checked(layers)
        self._weights, self._relative = weights, relative
        for name, value in asdict(weights).items():
            validate.not_negative(name, value)
        side = size * validate.positive("painting_scale", painting_scale)
        if side > _LARGEST:
            most = _LARGEST / size
            raise ValueError(
                f"painting_scale: expected at most {most:.3g} for images of {size} pixels, got {painting_scale}"
            )
        painting, mask = _prepared(painting, side)
        with torch.no_grad():
            self._styles = {name: gram(f, mask) for name, f in network(painting, self._layers).items()}
        self._palette = Palette.of(painting, mask)
        self.plain = self._palette.mean

    def background(self, count: int, _: torch.Generator) -> Tensor:
        """The painting's mean colour [count, 3], which is behind the object."""
        return self.plain.expand(count, 3)

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation) -> dict[str, Tensor]:
        """What to minimise the sum of: the losses by their names (see `StyleWeights`), each with its weight.

        Args:
            images: [B, 3, H, W] in [0, 1].
            masks: [B, H, W] in [0, 1].
            shape: of the mesh.
        """
        inside = (masks == 1).to(images.dtype)
        variation, content = losses.total_variation(images, inside), shape.movement.square().sum()
        palette = (self._palette.excess(images.movedim(1, -1)) * inside).sum()
        if self._relative:
            pixels = inside.sum().clamp(min=1)
            variation, palette, content = variation / pixels, palette / pixels, content / len(shape.start)
        return {
            "style": self._distances(images, masks).mean(),
            "content": self._weights.content * content,
            "bend": self._weights.bend * shape.bend,
            "variation": self._weights.variation * variation,
            "palette": self._weights.palette * palette,
        }

    @torch.no_grad()
    def measure(self, images: Tensor, masks: Tensor) -> Tensor:
        """The style loss of each image alone, [B]."""
        return self._distances(images, masks)

    def _distances(self, images: Tensor, masks: Tensor) -> Tensor:
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
    """The Gram matrices [B, C, C] of features [B, C, h, w] under masks [B, H, W], which are averaged down to h × w."""
    count, channels, height, width = features.shape
    masks = F.adaptive_avg_pool2d(masks[:, None], (height, width)).reshape(count, 1, -1)
    flat = features.reshape(count, channels, -1)
    area = masks.sum(2, keepdim=True).clamp(min=1e-6)
    return (flat * (masks / (channels * area))) @ flat.transpose(1, 2)


def _window(masks: Tensor) -> tuple[slice, slice]:
    """The rows and columns that hold all objects, with a margin, in steps that all pools divide."""
    found = []
    for axis in (2, 1):
        seen = torch.nonzero(masks.amax((0, axis)) > 0).flatten()
        last = masks.shape[3 - axis]
        low, high = (int(seen[0]), int(seen[-1]) + 1) if len(seen) else (0, last)
        found.append(slice(max(low - _MARGIN, 0) // 8 * 8, min(-(-(high + _MARGIN) // 8) * 8, last)))
    return found[0], found[1]


def _prepared(painting: Tensor, side: float) -> tuple[Tensor, Tensor]:
    """A painting [1, 3, h, w] of about side² pixels, and its mask [1, h, w]."""
    channels = getattr(painting, "shape", (3,))[0] if getattr(painting, "ndim", 3) == 3 else 3
    validate.floating("painting", painting, (4 if channels == 4 else 3, "H", "W"))
    height, width = painting.shape[1:]
    if min(height, width) < 16 or max(height, width) > 16 * min(height, width):
        raise ValueError(
            f"painting: expected at least 16 pixels on each side and none 16 times the other, got {width} x {height}"
        )
    mask = painting[3:] if channels == 4 else torch.ones_like(painting[:1])
    if float(mask.max()) < 0.5:
        raise ValueError("painting: expected a picture with something in it, got one that is transparent all over")
    shrink = side / math.sqrt(height * width)
    size = (max(round(height * shrink), 16), max(round(width * shrink), 16))
    both = torch.cat((painting[:3] * mask, mask))[None]
    both = F.interpolate(both, size, mode="bilinear", antialias=True, align_corners=False)
    mask = both[:, 3].clamp(0, 1)
    return (both[:, :3] / mask[:, None].clamp(min=1e-3)).clamp(0, 1), mask
