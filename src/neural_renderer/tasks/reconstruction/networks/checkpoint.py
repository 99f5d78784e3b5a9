"""Trained networks in files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ....features import features_like
from ....features.network import Plan
from ....io.atomic_write import write_file
from ....io.files import load_tensors, reason, short
from ....version import __version__
from .configs import Config
from .encoders import FEATURES, FeatureEncoder
from .make_network import Model, make_network

HEADER = "reconstruction"
"""The key of a checkpoint under which stands what `load_model` needs beside the weights."""

BEST, LAST = "best.ckpt", "last.ckpt"
"""The files of a training: its best network, and all that is needed to go on."""

VERSION = 1
"""Of the networks and of the header: one more whenever older weights would mean something else."""


def header(model: Model, classes: Sequence[str], weights: str) -> dict[str, Any]:
    """What `load_model` needs beside a checkpoint's "state_dict", in which ``weights`` begins the names of its own."""
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
    """Write a network, without the state of its training, and ``facts`` about it; OSError where that fails."""
    content = {HEADER: header(model, classes, "") | {"facts": facts}, "state_dict": model.state_dict()}
    file = io.BytesIO()  # since torch.save does not say why it cannot write
    torch.save(content, file)
    write_file(path, file.getbuffer())


def load_model(path: str | os.PathLike[str], device: torch.device | str = "cpu") -> Model:
    """The network of a checkpoint, ready to predict: of "best.ckpt" and "last.ckpt" of a training alike.

    Its ``kind`` is "mesh" or "voxel". A mesh network has ``vertices(images)``, from images [B, 4, 64, 64] in [0, 1]
    (red, green, blue, alpha) to [B, 642, 3], and ``faces`` [1280, 3]; a voxel network has ``occupancy(images)``, to
    probabilities [B, 32, 32, 32] in the axes of `arrays.Split.voxels`. All in the frame of `framing`.

    No code of the file is run. Raises FileNotFoundError, and ValueError for a file that is none of ours, of another
    version, or incomplete.
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
        raise ValueError(
            f"{path}: expected a network's weights, got others than its header says ({reason(error)})"
        ) from None
    if not all(bool(value.isfinite().all()) for value in found.values()):
        raise ValueError(f"{path}: expected finite weights, got some that are NaN or infinite")
    return network.to(device).eval().requires_grad_(False)


def _check_size(kind: str, config: Config, features: Plan, weights: dict[str, Tensor]) -> None:
    """ValueError for a header of a larger network than the weights are of, before memory is taken for it."""
    widths = (FEATURES, *config.hidden) if kind == "mesh" else ()
    needed = config.width**2 + sum(math.prod(pair) for pair in pairwise(widths))
    needed += sum(math.prod(shape) for shape in features.values())
    found = sum(value.numel() for value in weights.values())
    if needed > found:
        raise ValueError(f"expected at least {needed} numbers, got {found}")


def read_checkpoint(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of a checkpoint of this version, on the CPU; errors as `load_model`."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected a checkpoint, got {'a folder' if path.is_dir() else 'nothing there'}"
        )
    try:
        content = load_tensors(path)
    except Exception as error:  # whatever torch says of a file that is none of its own, or cut off
        if isinstance(error, OSError) and error.filename is not None:
            raise
        raise ValueError(f"{path}: expected a checkpoint, got a file that is broken or none") from None
    head = content.get(HEADER) if isinstance(content, dict) else None
    if not isinstance(head, dict) or "state_dict" not in content:
        raise ValueError(f"{path}: expected a checkpoint of a reconstruction network, got one of something else")
    if head.get("version") != VERSION:
        found = short(head.get("version"))
        raise ValueError(f"{path}: expected a checkpoint of version {VERSION}, got version {found}")
    return content
