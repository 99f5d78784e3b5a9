"""A small synthetic data set of boxes and balls."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import neural_renderer as nr
from neural_renderer.apps.reconstruct.data.arrays import Split
from neural_renderer.apps.reconstruct.data.framing import view_camera
from neural_renderer.apps.reconstruct.networks.configs import Config

SMALL = Config(
    encoder="light",
    width=8,
    hidden=(32,),
    objects=4,
    augment=True,
    optimiser="adamw",
    rate=2e-3,
    schedule="cosine",
    average=0.9,
    steps=6,
)


def synthetic_split(objects: int = 2, seed: int = 0) -> Split:
    """Make two classes of asymmetric objects with random sizes and colours."""
    generator = torch.Generator().manual_seed(seed)
    images = {}
    for name, (vertices, faces) in {"ball": nr.icosphere(1), "box": nr.cube()}.items():
        rows = []
        for _ in range(objects):
            size, place = torch.rand(2, 3, generator=generator)
            colour = torch.rand(3, generator=generator).expand(len(faces), 2, 2, 2, 3)
            mesh = nr.Mesh(vertices * (0.1 + 0.15 * size) + 0.3 * (place - 0.5), faces, colour)
            views = nr.render(mesh, view_camera(torch.arange(24)), 64)
            assert views.rgb is not None and views.alpha is not None
            rgba = torch.cat((views.rgb / views.alpha[:, None].clamp(min=1e-6), views.alpha[:, None]), 1)
            rows.append((rgba.detach().clamp(0, 1) * 255).round().byte().numpy())
        images[name] = np.stack(rows)
    names = {name: tuple(f"{name}-{i}" for i in range(objects)) for name in images}
    return Split(Path("synthetic"), "train", tuple(images), images, {}, names)


def write_split(folder: Path, split: str, objects: int = 2, seed: int = 0) -> None:
    """Write the images of `synthetic_split` in the published format."""
    for name, images in synthetic_split(objects, seed).images.items():
        np.savez_compressed(folder / f"{name}_{split}_images.npz", images)
