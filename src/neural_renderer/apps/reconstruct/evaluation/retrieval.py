"""The retrieval baseline (section 5.1 of the paper): the voxels of the most similar training image.

The paper compares features of VGG's layer fc6. GoogLeNet's last pool is an alternative with a smaller download.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ....io.atomic_write import replacing
from ...common.features import FeatureNetwork
from ..data.arrays import Split, cache_folder
from ..data.framing import VIEWS
from ..networks.encoders import on_white
from .predictors import Predictions, Predictor, VoxelPredictions

_LAYERS = ("fc6", "pool5")
_INPUT = 224  # side of the networks' input in pixels
_CHUNK = 1 << 15  # batch size of comparisons, in rows of features
_FINGERPRINT = 64  # numbers of each tensor that enter the fingerprint of a network


def feature_layer(network: FeatureNetwork) -> str:
    """Choose the layer to compare: fc6 of a VGG, the last pool of a GoogLeNet. Raises ValueError if it is missing."""
    name = _LAYERS[0] if network.name.startswith("VGG") else _LAYERS[1]
    if name not in network.layers:
        raise ValueError(f"features: expected a network with the layer {name}, got {network.name} without it")
    return name


@torch.no_grad()
def image_features(network: FeatureNetwork, images: Tensor) -> Tensor:
    """Compute features [B, D] float32 of images [B, 4, H, W] uint8, composited on white and resized to 224 pixels."""
    layer = feature_layer(network)
    return network(on_white(images.float() / 255, _INPUT), [layer])[layer].flatten(1)


class Retrieval:
    """Nearest-neighbour search among the training images. Features are cached in files per network and class.

    Raises FileNotFoundError if a class of the split has no voxels. The network stays on its device.
    """

    def __init__(self, split: Split, network: FeatureNetwork) -> None:
        missing = [name for name in split.classes if name not in split.voxels]
        if missing:
            path = split.folder / f"{missing[0]}_{split.split}_voxels.npz"
            raise FileNotFoundError(f"{path}: expected voxels to retrieve, got nothing there")
        self._split, self._network = split, network
        self._features: dict[str, np.ndarray] = {}
        self._known: list[tuple[str, int]] = []  # class and object of each row of features

    def prepare(self) -> Iterator[int]:
        """Compute the features that are not cached; yield the number of finished images."""
        done = 0
        stamp = _fingerprint(self._network)
        for name in self._split.classes:
            images = self._split.images[name]
            source = self._split.folder / f"{name}_{self._split.split}_images.npz"
            target = cache_folder(source) / f"{source.stem}_{stamp}.npy"
            features = _cached(target, source, VIEWS * len(images))
            if features is None:
                rows = []
                for index in range(len(images)):
                    views = torch.from_numpy(images[index].copy()).to(_device(self._network))
                    rows.append(image_features(self._network, views).cpu().numpy().astype(np.float16))
                    yield done + VIEWS * (index + 1)
                with replacing(target) as fresh:
                    with fresh.open("wb") as file:
                        np.save(file, np.concatenate(rows))
                    os.utime(fresh, ns=(source.stat().st_mtime_ns,) * 2)
                features = np.load(target, mmap_mode="r")
            self._features[name] = features
            self._known += [(name, index) for index in range(len(images))]
            done += VIEWS * len(images)
            yield done

    def nearest(self, images: Tensor) -> list[tuple[str, int]]:
        """Find the most similar training image of each image [B, 4, 64, 64] uint8; return its class and object."""
        wanted = image_features(self._network, images)
        best = torch.full((len(wanted),), torch.inf, device=wanted.device)
        row = torch.zeros(len(wanted), dtype=torch.int64, device=wanted.device)
        begin = 0
        for name in self._split.classes:
            features = self._features[name]
            for first in range(0, len(features), _CHUNK):
                part = torch.from_numpy(features[first : first + _CHUNK].astype(np.float32)).to(wanted)
                near, where = torch.cdist(wanted, part).min(1)
                closer = near < best
                best, row = torch.where(closer, near, best), torch.where(closer, where + begin + first, row)
            begin += len(features)
        return [self._known[index // VIEWS] for index in row.tolist()]

    def predictor(self) -> Predictor:
        """Return the method: the voxels of the most similar training image."""

        def predict(images: Tensor) -> Predictions:
            found = self.nearest(images)
            rows = [self._split.voxels[name][index] for name, index in found]
            return VoxelPredictions(torch.from_numpy(np.stack(rows)).to(images.device))

        return predict


def _cached(target: Path, source: Path, count: int) -> np.ndarray | None:
    """Memory-map cached features [count, D]; None if the file is missing, broken, or not as old as ``source``."""
    with contextlib.suppress(Exception):
        features = np.load(target, mmap_mode="r")
        fresh = target.stat().st_mtime_ns == source.stat().st_mtime_ns
        if fresh and features.dtype == np.float16 and features.ndim == 2 and len(features) == count:
            return features
    return None


def _device(network: FeatureNetwork) -> torch.device:
    """Return the device of a network; the CPU if it has no weights."""
    return next(iter(network.state_dict().values()), torch.zeros(())).device


def _fingerprint(network: FeatureNetwork) -> str:
    """Compute a short name that identifies a network and its weights."""
    digest = hashlib.sha256(network.name.encode())
    for value in network.state_dict().values():
        digest.update(value.detach().cpu().flatten()[:_FINGERPRINT].numpy().tobytes())
    return f"{network.name.lower()}_{digest.hexdigest()[:8]}"
