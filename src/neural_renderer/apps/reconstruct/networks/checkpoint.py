"""Networks by name, and their checkpoint files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from ....io.atomic_write import write_file
from ....io.files import existing, reason, short
from ....version import __version__
from ...common.features import FeatureNetwork, features_like
from ...common.features.network import Plan
from ...common.saved_tensors import load_tensors
from .configs import Config
from .encoders import FEATURES, FeatureEncoder
from .mesh_network import MeshNetwork
from .voxel_network import VoxelNetwork

HEADER = "reconstruction"
"""Key of the `header` in a checkpoint."""

BEST, LAST = "best.ckpt", "last.ckpt"
"""Files of a training: its best network, and the state from which it resumes."""

VERSION = 1
"""Version of networks and header. Increase it when a change gives older weights another meaning."""

Model = MeshNetwork | VoxelNetwork

NETWORKS: dict[str, type[MeshNetwork] | type[VoxelNetwork]] = {"mesh": MeshNetwork, "voxel": VoxelNetwork}


def make_network(kind: str, config: Config, features: FeatureNetwork | None = None) -> Model:
    """Make a network, "mesh" or "voxel", with random weights; ``features`` is the network of the encoder "features"."""
    if kind not in NETWORKS:
        raise ValueError(f"model: expected one of {', '.join(NETWORKS)}, got {kind!r}")
    return NETWORKS[kind](config, features)


def header(model: Model, classes: Sequence[str], weights: str) -> dict[str, Any]:
    """Make the header of a checkpoint: everything that `load_model` needs besides the weights.

    ``weights`` is the prefix of the network's tensors in the checkpoint's "state_dict".
    """
    encoder = model.encoder
    features = {"features": encoder.features.plan} if isinstance(encoder, FeatureEncoder) else {}
    return features | {
        "version": VERSION,
        "library": __version__,
        "kind": model.kind,
        "config": model.config.to_dict(),
        "classes": list(classes),
        "weights": weights,
    }


def save_model(path: str | os.PathLike[str], model: Model, classes: Sequence[str], **facts: float) -> None:
    """Write a network, with the classes it was trained on and further numbers, without the state of its training."""
    content = {HEADER: header(model, classes, "") | {"facts": facts}, "state_dict": model.state_dict()}
    file = io.BytesIO()  # torch.save to a path does not report why it cannot write
    torch.save(content, file)
    write_file(path, file.getbuffer())


def load_model(path: str | os.PathLike[str], device: torch.device | str = "cpu") -> Model:
    """Load a trained network for prediction, from ``best.ckpt`` or ``last.ckpt``.

    No code of the file is executed.

    Args:
        path: Checkpoint file.
        device: Device of the network.

    Returns:
        A network whose ``kind`` is "mesh" or "voxel", in evaluation mode and frozen. A mesh network has
        ``vertices(images)``, which maps RGBA images [B, 4, 64, 64] in [0, 1] to [B, 642, 3], and ``faces`` [1280, 3].
        A voxel network has ``occupancy(images)``, which returns probabilities [B, 32, 32, 32] in the axes of
        `voxels.voxelize`. Both are in the reconstruction frame (see `framing`).

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not a checkpoint of a reconstruction network, has another version, or is incomplete.

    Example:
        >>> from neural_renderer.apps.reconstruct.networks.configs import make_config
        >>> save_model("best.ckpt", make_network("mesh", make_config("small", ["chair"])), ["chair"])
        >>> network = load_model("best.ckpt")
        >>> network.vertices(torch.rand(1, 4, 64, 64)).shape
        torch.Size([1, 642, 3])
    """
    content = read_checkpoint(path)
    head, weights = content[HEADER], content["state_dict"]
    try:
        config = Config.from_dict(head["config"])
        _check_size(head["kind"], config, head.get("features", {}), weights)
        features = features_like(head["features"]) if "features" in head else None
        network = make_network(head["kind"], config, features)
        prefix = head["weights"]
        found = {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}
        network.load_state_dict(found)
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError, OverflowError) as error:
        raise ValueError(f"{path}: expected weights that match its header, got others ({reason(error)})") from None
    if not all(bool(value.isfinite().all()) for value in found.values()):
        raise ValueError(f"{path}: expected finite weights, got NaN or infinity")
    return network.to(device).eval().requires_grad_(False)


def _check_size(kind: str, config: Config, features: Plan, weights: dict[str, Tensor]) -> None:
    """Raise ValueError if a header describes a larger network than the file holds, before memory is allocated."""
    widths = (FEATURES, *config.hidden) if kind == "mesh" else ()
    needed = config.width**2 + sum(math.prod(pair) for pair in pairwise(widths))
    needed += sum(math.prod(shape) for shape in features.values())
    found = sum(value.numel() for value in weights.values())
    if needed > found:
        raise ValueError(f"expected at least {needed} numbers, got {found}")


def read_checkpoint(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the content of a checkpoint onto the CPU. Errors: see `load_model`."""
    path = existing(path, "a checkpoint")
    try:
        content = load_tensors(path)
    except Exception as error:  # torch raises errors of many classes for files that are not checkpoints, or truncated
        if isinstance(error, OSError) and error.filename is not None:
            raise
        raise ValueError(f"{path}: expected a checkpoint, got a file that is broken or of another format") from None
    head = content.get(HEADER) if isinstance(content, dict) else None
    if not isinstance(head, dict) or "state_dict" not in content:
        raise ValueError(f"{path}: expected a checkpoint of a reconstruction network, got another checkpoint")
    if head.get("version") != VERSION:
        found = short(head.get("version"))
        raise ValueError(f"{path}: expected a checkpoint of version {VERSION}, got version {found}")
    return content
