"""What each step of training looks at: a function of the seed and the step's number, whatever happened before.

So a training that is resumed sees what it would have seen, and several processes share a batch without talking.
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


class Batches(Dataset[dict[str, Tensor]]):
    """The batches of steps ``first`` to ``last`` − 1, of which process ``rank`` of ``world`` gets its share.

    An item is a dictionary: "images" uint8 [V, n, 4, 64, 64], the views of n objects, and "views" int64 [V, n], which
    of the 24 they are; with ``config.augment`` also "flip" bool [n] and "colour" float32 [n, 3, 4].

    Raises ValueError if the processes cannot share the batch evenly.
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
            batch["colour"] = _colours(generator, count)
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


def _colours(generator: np.random.Generator, count: int) -> np.ndarray:
    """Random affine maps of colour [count, 3, 4]: channels mixed towards grey or each other, gains and offsets."""
    mix = np.eye(3) + generator.normal(0, 0.15, (count, 3, 3))
    grey = generator.random((count, 1, 1)) * (generator.random((count, 1, 1)) < 0.3)
    gain = np.exp(generator.normal(0, 0.2, (count, 1, 1)))
    matrix = gain * ((1 - grey) * mix + grey / 3)
    return np.concatenate((matrix, generator.normal(0, 0.08, (count, 3, 1))), 2).astype(np.float32)


def prepared(batch: dict[str, Tensor], inputs: int) -> tuple[Tensor, Tensor, Tensor]:
    """A batch ready for a network.

    Returns the first ``inputs`` views as images [I, n, 4, 64, 64] in [0, 1], the alpha of all views [V, n, 64, 64] in
    [0, 1], and which views they are [V, n]. Mirrored at z = 0, an object looks from view k as it did from view 12 − k,
    left and right exchanged.
    """
    pixels, views = batch["images"], batch["views"]
    if "flip" in batch:
        flip = batch["flip"]
        pixels = torch.where(flip[:, None, None, None], pixels.flip(-1), pixels)
        views = torch.where(flip, mirrored_views(views), views)
    images, alpha = pixels[:inputs].float() / 255, pixels[:, :, 3].float() / 255
    if "colour" in batch:
        matrix, mask = batch["colour"], images[:, :, 3:]
        rgb = torch.einsum("nij,vnjhw->vnihw", matrix[..., :3], images[:, :, :3]) + matrix[None, :, :, 3, None, None]
        images = torch.cat((rgb.clamp(0, 1) * mask, mask), 2)
    return images, alpha, views


def mirrored_views(views: Tensor) -> Tensor:
    """The views [...] that show the object mirrored at z = 0 as ``views`` show it, left and right exchanged.

    Most things are symmetric about that plane: it is x = 0 of the models, whose fronts are at ±z.
    """
    return (VIEWS // 2 - views) % VIEWS
