"""`neural-renderer reconstruct train`: training of a reconstruction network from images only."""

from __future__ import annotations

import logging
import math
import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from ...common.command import choose_device, interruption, load_network, say
from ...common.features import FeatureNetwork
from ...common.options import WatchOptions
from ...view.watching import stay, watching
from ..data.arrays import Split, classes_of, open_split
from ..networks.checkpoint import BEST, HEADER, LAST, read_checkpoint
from ..networks.configs import Config, make_config
from ..networks.encoders import FeatureEncoder
from ..options import TrainOptions
from ..settings import RunSettings


def run(options: TrainOptions) -> int:
    """Train a network; return the exit code: 0, or 130 after Ctrl-C."""
    choose_device(options.device)
    data, val = _open_data(options)
    config = _make_config(options, data)
    features = None if options.features is None else load_network(options.features, "--features")
    checkpoint = _check_checkpoint(options, config, data, features)
    # Lightning takes seconds to import.
    from ..training.callbacks import STOPPED
    from ..training.train import train

    with watching(_watch_options(options)) as viewer:
        with _quiet(), _resumable(), interruption() as interrupted:
            training = train(
                options.model,
                config,
                data,
                val,
                options.out,
                _run_settings(options, config),
                checkpoint=checkpoint,
                features=features,
                interrupted=interrupted,
                observer=viewer,
            )
        is_kept = training.done or interrupted == [STOPPED]
        if training.trainer.is_global_zero:
            resume = "" if training.done else "; interrupted, --resume continues"
            say(f"{training.steps_done} steps in {training.seconds:.0f} s{resume}; the results are in {options.out}")
        stay(viewer, is_kept)
    return 0 if is_kept else 130


def _run_settings(options: TrainOptions, config: Config) -> RunSettings:
    same = {name: getattr(options, name) for name in ("every", "seed", "workers", "devices", "nodes", "device")}
    return RunSettings(
        math.inf if options.minutes is None else options.minutes,
        low_precision=config.low_precision if options.precision == "auto" else options.precision == "bf16",
        **same,
    )


def _watch_options(options: TrainOptions) -> WatchOptions:
    """Return the options of the viewer; only the first of several processes has one."""
    ranks = [os.environ.get(name, "0") for name in ("LOCAL_RANK", "NODE_RANK", "GROUP_RANK", "SLURM_PROCID")]
    return options.watch if all(rank == "0" for rank in ranks) else WatchOptions()


def _open_data(options: TrainOptions) -> tuple[Split, Split | None]:
    """Open training and validation split; warn about classes without validation data."""
    data = open_split(options.data, "train", options.classes or None)
    there = classes_of(options.data, "val")
    present = [name for name in data.classes if name in there]
    missing = [name for name in data.classes if name not in present]
    if missing:
        consequence = "" if present else f"; {BEST} will be the network of the last step"
        say(f"{', '.join(missing)}: no images of the split val for validation{consequence}", "yellow")
    return data, open_split(options.data, "val", present) if present else None


def _make_config(options: TrainOptions, data: Split) -> Config:
    """Make the configuration, and apply the options that change it."""
    config = make_config(options.config, data.classes)
    if options.features is not None:
        config = replace(config, encoder="features")
    if options.steps is not None:
        config = replace(config, steps=options.steps)
    for name in ("smoothness", "laplacian", "blur"):
        weight = getattr(options, name)
        config = config if weight is None else replace(config, **{name: weight})
    return config


def _check_checkpoint(
    options: TrainOptions, config: Config, data: Split, features: FeatureNetwork | None
) -> Path | None:
    """Find the checkpoint to resume from, or None; ValueError if it is not to be resumed, or has other settings."""
    path = options.out / LAST
    if not path.exists():
        if (options.out / BEST).exists():
            raise ValueError(f"{options.out / BEST}: expected a folder without a network, or with {LAST}")
        return None
    if not options.resume:
        raise ValueError(f"{path}: expected a folder without a training, got one; --resume continues it")
    content = read_checkpoint(path)
    if "training" not in content:
        raise ValueError(f"{path}: expected the state of a training, got a network only, like best.ckpt")
    head = content[HEADER]
    state = content["training"]
    found = {"model": head["kind"], "classes": head["classes"], "seed": state["seed"]} | head["config"]
    wanted = {"model": options.model, "classes": list(data.classes), "seed": options.seed} | config.to_dict()
    for name in wanted:
        if name != "steps" and found.get(name) != wanted[name]:
            raise ValueError(f"{path}: expected a checkpoint with {name} {wanted[name]}, got {found.get(name)}")
    if features is not None and not _has_features(content["state_dict"], features):
        raise ValueError(f"{path}: expected a checkpoint with the features of {options.features}, got other features")
    if config.steps < state["steps"]:
        raise ValueError(f"--steps: expected at least the {state['steps']} steps already taken, got {config.steps}")
    return path


def _has_features(weights: dict[str, Tensor], features: FeatureNetwork) -> bool:
    """Return whether the network of a checkpoint uses these features."""
    prefix = "network.encoder.features."
    found = {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}
    wanted = FeatureEncoder(features).features.state_dict()
    return found.keys() == wanted.keys() and all(torch.equal(found[name], wanted[name]) for name in wanted)


@contextmanager
def _resumable() -> Iterator[None]:
    """Add the option that continues a training whose processes were lost."""
    try:
        yield
    except ConnectionError as error:
        raise ConnectionError(f"{error} (--resume)") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress Lightning's messages. They are advice for programmers.

    Errors about a full disk in TensorBoard's thread are suppressed, too: its next write raises them again.
    """
    logger = logging.getLogger("lightning.pytorch")
    level, hook = logger.level, threading.excepthook
    logger.setLevel(logging.ERROR)
    threading.excepthook = lambda arguments: None if arguments.exc_type is OSError else hook(arguments)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="lightning")
            yield
    finally:
        logger.setLevel(level)
        threading.excepthook = hook
