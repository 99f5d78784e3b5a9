"""Training batches as a function of seed and step.

A resumed training therefore gets the same batches, and several processes share a batch without communication.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from ..data.arrays import Split
from ..data.framing import VIEWS
from ..networks.configs import Config

_GREY_CHANCE = 0.3  # share of objects whose colours are mixed with grey
_MIX, _GAIN, _OFFSET = 0.15, 0.2, 0.08  # standard deviations of channel mixing, log gain and offset


class Batches(Dataset[dict[str, Tensor]]):
    """Batches of the steps from ``first`` to before ``last``, or the share of process ``rank`` of ``world``.

    An item is a dictionary: "images" uint8 [V, n, 4, 64, 64], views of n objects; "views" int64 [V, n], their numbers;
    and with ``config.augment`` also "flip" bool [n] and "color" float32 [n, 3, 4], an affine map of RGB. The number of
    processes must divide the number of objects in a batch.
    """

    def __init__(
        self, split: Split, config: Config, seed: int, first: int, last: int, rank: int = 0, world: int = 1
    ) -> None:
        if config.objects % world:
            raise ValueError(f"devices: expected a divisor of the batch of {config.objects} objects, got {world}")
        self._split, self._config, self._seed, self._steps = split, config, seed, range(first, last)
        count = config.objects // world
        self._share = slice(rank * count, (rank + 1) * count)

    def __len__(self) -> int:
        return len(self._steps)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        config, split = self._config, self._split
        generator = np.random.default_rng((self._seed, self._steps[index]))
        count = config.objects
        classes = generator.integers(len(split.classes), size=count)
        chances = generator.random(count)
        views = generator.integers(VIEWS, size=(config.views, count))
        batch: dict[str, Any] = {"views": views}
        if config.augment:
            batch["flip"] = generator.random(count) < 0.5
            batch["color"] = _color_maps(generator, count)
        batch = {
            name: value[..., self._share] if name == "views" else value[self._share] for name, value in batch.items()
        }
        images = np.empty((config.views, len(classes[self._share]), 4, 64, 64), np.uint8)
        for place, (number, chance) in enumerate(zip(classes[self._share], chances[self._share], strict=True)):
            objects = split.images[split.classes[number]]
            item = objects[int(chance * len(objects))]
            for view in range(config.views):
                images[view, place] = item[batch["views"][view, place]]
        return {"images": torch.from_numpy(images), **{name: torch.from_numpy(value) for name, value in batch.items()}}


def _color_maps(generator: np.random.Generator, count: int) -> np.ndarray:
    """Draw random affine maps of RGB [count, 3, 4]: channels mixed with grey or each other, gains and offsets."""
    mix = np.eye(3) + generator.normal(0, _MIX, (count, 3, 3))
    grey = generator.random((count, 1, 1)) * (generator.random((count, 1, 1)) < _GREY_CHANCE)
    gain = np.exp(generator.normal(0, _GAIN, (count, 1, 1)))
    matrix = gain * ((1 - grey) * mix + grey / 3)
    return np.concatenate((matrix, generator.normal(0, _OFFSET, (count, 3, 1))), 2).astype(np.float32)


def prepare_batch(batch: dict[str, Tensor], inputs: int) -> tuple[Tensor, Tensor, Tensor]:
    """Convert a batch, an item of `Batches`, to floating point, and apply its augmentation.

    An object mirrored at z = 0 looks from view k as the original looks from view 12 − k, flipped horizontally. Returns
    images of the first I views, the inputs of the network, [I, n, 4, 64, 64] in [0, 1]; alpha of all views, [V, n, 64,
    64] in [0, 1]; and the numbers of the views, [V, n].
    """
    pixels, views = batch["images"], batch["views"]
    if "flip" in batch:
        flip = batch["flip"]
        pixels = torch.where(flip[:, None, None, None], pixels.flip(-1), pixels)
        views = torch.where(flip, mirrored_views(views), views)
    images, alpha = pixels[:inputs].float() / 255, pixels[:, :, 3].float() / 255
    if "color" in batch:
        matrix, mask = batch["color"], images[:, :, 3:]
        rgb = torch.einsum("nij,vnjhw->vnihw", matrix[..., :3], images[:, :, :3]) + matrix[None, :, :, 3, None, None]
        images = torch.cat((rgb.clamp(0, 1) * mask, mask), 2)
    return images, alpha, views


def mirrored_views(views: Tensor) -> Tensor:
    """Compute the views [...] of an object mirrored at z = 0 that equal the given views, flipped horizontally.

    Most objects are symmetric about this plane. In the frame of the models it is x = 0; their fronts are at ±z.
    """
    return (VIEWS // 2 - views) % VIEWS
