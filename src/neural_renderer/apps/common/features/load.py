"""Feature networks from weight files and from published checkpoints."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ....io.files import existing, import_library, reason
from ..saved_tensors import load_tensors, why_not_loaded
from .googlenet import googlenet, is_googlenet
from .network import FeatureNetwork, Plan
from .vgg import is_vgg, vgg

_ADDRESS = "https://download.pytorch.org/models/"
# The eight digits in each name are the start of the file's SHA-256; torch.hub checks the download against them.
PUBLISHED = {
    "vgg16-original": "vgg16_features-amdegroot-88682ab5.pth",
    "vgg16": "vgg16-397923af.pth",
    "vgg19": "vgg19-dcbb9e9d.pth",
    "googlenet": "googlenet-1378be20.pth",
}
"""Published checkpoints by name. ``vgg16-original`` has the weights that Simonyan and Zisserman trained."""


def load_features(source: str | os.PathLike[str], progress: bool = True) -> FeatureNetwork:
    """Load a feature network onto the CPU.

    Args:
        source: Name in `PUBLISHED`, which torch.hub downloads once and caches, or path of a file: ``.safetensors``, or
            a PyTorch checkpoint with a state_dict. The names of its tensors identify the network (see `vgg` and
            `googlenet`).
        progress: Whether to show a progress bar while downloading.

    Returns:
        The network, with frozen weights.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is unreadable or holds another network.
        ConnectionError: The checkpoint is not cached and cannot be downloaded.
        ModuleNotFoundError: The file is ``.safetensors`` and the package safetensors is not installed.

    Example:
        >>> weights = {"conv1_1.weight": torch.rand(8, 3, 3, 3), "conv1_1.bias": torch.zeros(8)}
        >>> torch.save(weights, "narrow_vgg.pth")
        >>> load_features("narrow_vgg.pth").layers
        ('conv1_1',)
    """
    if isinstance(source, str) and source in PUBLISHED:
        return _network(_published(source, progress), source)
    path = existing(source)
    return _network(_read(path), str(path))


def features_like(plan: Plan) -> FeatureNetwork:
    """Build a network of zeros; `load_state_dict` fills it.

    Args:
        plan: `FeatureNetwork.plan` of a network with the same architecture.

    Returns:
        The network, on the CPU.

    Raises:
        ValueError: The plan belongs to no known network.

    Example:
        >>> network = features_like({"conv1_1.weight": (8, 3, 3, 3), "conv1_1.bias": (8,)})
        >>> network.layers
        ('conv1_1',)
    """
    return _network({name: torch.zeros(tuple(shape)) for name, shape in plan.items()}, "plan")


def _network(weights: dict[str, Tensor], source: str) -> FeatureNetwork:
    """Build the network of a checkpoint; messages name ``source``."""
    weights = {name: value.float() for name, value in weights.items() if isinstance(value, Tensor)}
    try:
        if is_googlenet(weights) or is_vgg(weights):
            return _finite(googlenet(weights) if is_googlenet(weights) else vgg(weights))
    except ValueError as error:
        raise ValueError(f"{source}: {error}; the file is damaged or holds another network") from None
    some = ", ".join(list(weights)[:3]) or "none"
    raise ValueError(
        f"{source}: expected the weights of a VGG (features.0.weight or conv1_1.weight, …) or of a GoogLeNet "
        f"(inception3a.… or inception_3a.…), got tensors with other names ({some}, …)"
    )


def _finite(network: FeatureNetwork) -> FeatureNetwork:
    for name, value in network.named_parameters():
        if not bool(torch.isfinite(value).all()):
            raise ValueError(f"expected finite weights, got NaN or infinity in {name.removeprefix('_stages.')}")
    return network


def _read(path: Path) -> dict[str, Any]:
    if path.suffix.lower() == ".safetensors":
        safetensors = import_library("safetensors.torch", f"to read {path}")
        try:
            return dict(safetensors.load_file(path))
        except Exception as error:  # SafetensorError, and other classes for a broken header
            raise ValueError(
                f"{path}: expected a .safetensors file, got one that cannot be read ({reason(error)})"
            ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about pickle versions of files that are rejected anyway
            weights = load_tensors(path)
    except Exception as error:  # torch raises errors of many classes for files that are not checkpoints
        raise ValueError(
            f"{path}: expected a PyTorch checkpoint, got a file that cannot be read ({why_not_loaded(error)})"
        ) from None
    weights = weights.get("state_dict", weights) if isinstance(weights, dict) else weights
    if not isinstance(weights, dict):
        raise ValueError(f"{path}: expected a state_dict, got a {type(weights).__name__}")
    return weights


def _published(name: str, progress: bool) -> dict[str, Any]:
    """Download a published checkpoint, or load it from the cache."""
    address = _ADDRESS + PUBLISHED[name]
    try:
        return torch.hub.load_state_dict_from_url(
            address, map_location="cpu", progress=progress, check_hash=True, weights_only=True
        )
    except Exception as error:  # no network, unknown address, wrong checksum, full disk
        raise ConnectionError(
            f"{name}: {address} cannot be downloaded ({error}); download it elsewhere and give the path of the file"
        ) from None
