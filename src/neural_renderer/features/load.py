"""Weights from files and from the addresses where they are published."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..io.files import existing, load_tensors, reason, why_not_loaded
from .googlenet import googlenet, is_googlenet
from .network import FeatureNetwork, Plan
from .vgg import is_vgg, vgg

_ADDRESS = "https://download.pytorch.org/models/"
# The eight digits in each name begin the file's SHA-256, which torch.hub holds the download to.
PUBLISHED = {
    "vgg16-original": "vgg16_features-amdegroot-88682ab5.pth",
    "vgg16": "vgg16-397923af.pth",
    "vgg19": "vgg19-dcbb9e9d.pth",
    "googlenet": "googlenet-1378be20.pth",
}
"""The published checkpoints by name; ``vgg16-original`` has the convolutions of Simonyan and Zisserman themselves."""


def load_features(source: str | os.PathLike[str], progress: bool = True) -> FeatureNetwork:
    """The network of a checkpoint, on the CPU.

    Args:
        source: one of `PUBLISHED`, which torch.hub fetches once and keeps; or a file, ``.safetensors`` or a state_dict
            of torch, whose network is told by the names of its tensors (see `vgg` and `googlenet`).
        progress: whether a download shows how far it is.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a file that cannot be read or that holds another network.
        ConnectionError: a checkpoint that is not here and cannot be fetched.
        ModuleNotFoundError: a .safetensors file without that package.
    """
    if isinstance(source, str) and source in PUBLISHED:
        return _network(_published(source, progress), source)
    path = existing(source)
    return _network(_read(path), str(path))


def features_like(plan: Plan) -> FeatureNetwork:
    """A network with a `FeatureNetwork.plan`, all zeros: to be filled by ``load_state_dict``.

    Raises ValueError for a plan of no network that is known.
    """
    return _network({name: torch.zeros(tuple(shape)) for name, shape in plan.items()}, "plan")


def _network(weights: dict[str, Tensor], source: str) -> FeatureNetwork:
    weights = {name: value.float() for name, value in weights.items() if isinstance(value, Tensor)}
    try:
        if is_googlenet(weights) or is_vgg(weights):
            return _finite(googlenet(weights) if is_googlenet(weights) else vgg(weights))
    except ValueError as error:
        raise ValueError(f"{source}: {error}; the file is damaged or of another network") from None
    some = ", ".join(list(weights)[:3]) or "none"
    raise ValueError(
        f"{source}: expected the weights of a VGG (features.0.weight or conv1_1.weight, …) or of a GoogLeNet "
        f"(inception3a.… or inception_3a.…), got tensors with other names ({some}, …)"
    )


def _finite(network: FeatureNetwork) -> FeatureNetwork:
    for name, value in network.named_parameters():
        if not bool(torch.isfinite(value).all()):
            raise ValueError(f"expected finite numbers, got NaN or infinite ones in {name.removeprefix('_stages.')}")
    return network


def _read(path: Path) -> dict[str, Any]:
    if path.suffix.lower() == ".safetensors":
        try:
            from safetensors.torch import load_file
        except ModuleNotFoundError:
            raise ModuleNotFoundError(
                f"{path}: to read it, install safetensors (pip install 'neural-renderer[editing]')"
            ) from None
        try:
            return load_file(path)
        except Exception as error:  # its own kinds, and whatever a broken header leads to
            raise ValueError(
                f"{path}: expected a whole .safetensors file, got one that cannot be read ({reason(error)})"
            ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pickle's version, in files that are refused anyway
            weights = load_tensors(path)
    except Exception as error:  # torch has many words for files that are not its own
        raise ValueError(
            f"{path}: expected a whole checkpoint of torch, got a file that cannot be read ({why_not_loaded(error)})"
        ) from None
    weights = weights.get("state_dict", weights) if isinstance(weights, dict) else weights
    if not isinstance(weights, dict):
        raise ValueError(f"{path}: expected a state_dict, got a {type(weights).__name__}")
    return weights


def _published(name: str, progress: bool) -> dict[str, Any]:
    address = _ADDRESS + PUBLISHED[name]
    try:
        return torch.hub.load_state_dict_from_url(
            address, map_location="cpu", progress=progress, check_hash=True, weights_only=True
        )
    except Exception as error:  # no network, no such address, a checksum that differs, no room
        raise ConnectionError(
            f"{name}: {address} cannot be fetched ({error}); fetch it elsewhere, and name the file instead"
        ) from None
