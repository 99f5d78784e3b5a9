"""The retrieval baseline: the voxels of the training image that looks most alike to a network for recognition.

As in the paper (section 5.1), which compares VGG's layer fc6; GoogLeNet's last pool serves where only that is at hand.
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

from ....features import FeatureNetwork
from ....io.atomic_write import replacing
from ..data.arrays import Split, cache_folder
from ..data.framing import VIEWS
from ..networks.encoders import on_white
from .predictors import Predictor, Shapes, Solids

_LAYERS = ("fc6", "pool5")
_INPUT = 224
_BATCH = 32


def feature_layer(network: FeatureNetwork) -> str:
    """The layer that is compared: fc6 of a VGG, the last pool of a GoogLeNet; ValueError for a network without."""
    name = _LAYERS[0] if network.name.startswith("VGG") else _LAYERS[1]
    if name not in network.layers:
        raise ValueError(f"features: expected a network with the layer {name}, got {network.name} without it")
    return name


@torch.no_grad()
def image_features(network: FeatureNetwork, images: Tensor) -> Tensor:
    """Features [B, D] float32 of images uint8 [B, 4, H, W], shown on white and enlarged to the network's 224 pixels."""
    layer = feature_layer(network)
    return network(on_white(images.float() / 255, _INPUT), [layer])[layer].flatten(1)


class Retrieval:
    """The training images' features, kept in files so that they are computed once for each network and class.

    split: the training split, with voxels. network: see `image_features`, on the device to compute on.
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
        """Compute what is not in files yet; yields how many images are done, after each few."""
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
        """Class and number of the training object whose image is nearest to each of [B, 4, 64, 64] uint8."""
        wanted = image_features(self._network, images)
        best = torch.full((len(wanted),), torch.inf, device=wanted.device)
        row = torch.zeros(len(wanted), dtype=torch.int64, device=wanted.device)
        begin = 0
        for name in self._split.classes:
            features = self._features[name]
            for first in range(0, len(features), 1 << 15):
                part = torch.from_numpy(features[first : first + (1 << 15)].astype(np.float32)).to(wanted)
                near, where = torch.cdist(wanted, part).min(1)
                closer = near < best
                best, row = torch.where(closer, near, best), torch.where(closer, where + begin + first, row)
            begin += len(features)
        return [self._known[index // VIEWS] for index in row.tolist()]

    def predictor(self) -> Predictor:
        """What looks most alike, as voxels."""

        def predict(images: Tensor) -> Shapes:
            found = self.nearest(images)
            rows = [self._split.voxels[name][index] for name, index in found]
            return Solids(torch.from_numpy(np.stack(rows)).to(images.device))

        return predict


def _cached(target: Path, source: Path, count: int) -> np.ndarray | None:
    """Features [count, D] in a file that are those of the images in another; None for one that is older or broken."""
    with contextlib.suppress(Exception):
        features = np.load(target, mmap_mode="r")
        fresh = target.stat().st_mtime_ns == source.stat().st_mtime_ns
        if fresh and features.dtype == np.float16 and features.ndim == 2 and len(features) == count:
            return features
    return None


def _device(network: FeatureNetwork) -> torch.device:
    return next(iter(network.state_dict().values()), torch.zeros(())).device


def _fingerprint(network: FeatureNetwork) -> str:
    """A few letters that tell networks and their weights apart."""
    digest = hashlib.sha256(network.name.encode())
    for value in network.state_dict().values():
        digest.update(value.detach().cpu().flatten()[:64].numpy().tobytes())
    return f"{network.name.lower()}_{digest.hexdigest()[:8]}"
