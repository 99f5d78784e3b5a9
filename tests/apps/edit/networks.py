"""Networks so narrow that a test has time for them."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

_PLAN = (2, 2, 3, 3)


def vgg_weights(width: int = 6) -> dict[str, Tensor]:
    """Weights of a VGG up to conv4_3, by its names: random means over neighbours, which a descent finds easy."""
    generator = torch.Generator().manual_seed(3)
    found = {"conv0.weight": torch.eye(3)[:, :, None, None], "conv0.bias": torch.zeros(3)}
    inputs = 3
    for block, count in enumerate(_PLAN, 1):
        for place in range(1, count + 1):
            kernel = torch.rand(width, inputs, 3, 3, generator=generator) ** 4
            found[f"conv{block}_{place}.weight"] = kernel / kernel.sum((1, 2, 3), keepdim=True)
            found[f"conv{block}_{place}.bias"] = torch.zeros(width)
            inputs = width
    return found


def saved_vgg(folder: Path) -> Path:
    path = folder / "narrow.pth"
    torch.save(vgg_weights(), path)
    return path
