"""`neural-renderer reconstruct train`: a network that turns one picture into a mesh, from pictures alone."""

from __future__ import annotations

import logging
import math
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from rich.console import Console
from torch import Tensor

from ...features import FeatureNetwork, load_features
from ...tasks.reconstruction.data.arrays import Split, open_split
from ...tasks.reconstruction.networks.checkpoint import BEST, HEADER, LAST, read_checkpoint
from ...tasks.reconstruction.networks.configs import Config, make_config
from ...tasks.reconstruction.networks.encoders import FeatureEncoder
from ..common import checked_count, chosen_device, interruption, output_folder
from ..options.reconstruct.train import TrainOptions


@dataclass(frozen=True)
class Train(TrainOptions):
    """Trains a network, as the options say."""

    def run(self) -> int:
        """Train; returns the exit code: 0, or 130 after Ctrl-C. Raises ValueError or OSError."""
        for name, least in {"every": 1, "seed": 0, "devices": 1, "nodes": 1, "workers": 0}.items():
            checked_count(name, getattr(self, name), least)
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise ValueError(f"--minutes: expected a number above 0, got {self.minutes}")
        chosen_device(self.device)
        data, val = self._data()
        config = self._recipe(data)
        features = None if self.features is None else load_features(self.features)
        checkpoint = self._checkpoint(config, data, features)
        output_folder("OUT", self.out)
        from ...tasks.reconstruction.training.train import train  # Lightning takes seconds to import

        with _quiet(), interruption() as interrupted:
            training = train(
                self.model,
                config,
                data,
                val,
                self.out,
                minutes=math.inf if self.minutes is None else self.minutes,
                every=self.every,
                seed=self.seed,
                workers=self.workers,
                devices=self.devices,
                nodes=self.nodes,
                device=self.device,
                low_precision=config.low_precision if self.precision == "auto" else self.precision == "bf16",
                checkpoint=checkpoint,
                features=features,
                interrupted=interrupted,
            )
        if training.trainer.is_global_zero:
            ending = "" if training.done else "; interrupted, --resume goes on"
            text = f"{training.steps_done} steps in {training.seconds:.0f} s{ending}; the results are in {self.out}"
            Console().print(text, highlight=False, soft_wrap=True)
        return 0 if training.done else 130

    def _data(self) -> tuple[Split, Split | None]:
        classes = self.classes or None
        train = open_split(self.data, "train", classes)
        present = [name for name in train.classes if (self.data / f"{name}_val_images.npz").exists()]
        missing = [name for name in train.classes if name not in present]
        if missing:
            then = "" if present else f"; {BEST} will be the network of the last step"
            text = f"{', '.join(missing)}: no pictures of the split val, which are measured on{then}"
            Console(stderr=True).print(text, style="yellow", highlight=False, soft_wrap=True)
        return train, open_split(self.data, "val", present) if present else None

    def _recipe(self, train: Split) -> Config:
        config = make_config(self.config, train.classes)
        if self.features is not None:
            config = replace(config, encoder="features")
        if self.steps is not None:
            config = replace(config, steps=checked_count("steps", self.steps, 1))
        for name in ("smoothness", "laplacian", "blur"):
            weight = getattr(self, name)
            if weight is not None and not 0 <= weight < math.inf:
                raise ValueError(f"--{name}: expected a number of at least 0, got {weight}")
            config = config if weight is None else replace(config, **{name: weight})
        return config

    def _checkpoint(self, config: Config, train: Split, features: FeatureNetwork | None) -> Path | None:
        """What to go on from. A training that was not asked for again is not written over."""
        path = self.out / LAST
        if not path.exists():
            if (self.out / BEST).exists():
                raise ValueError(
                    f"{self.out / BEST}: expected a folder without a network, or one with {LAST} beside it"
                )
            return None
        if not self.resume:
            raise ValueError(f"{path}: expected no training in this folder yet, got one; --resume goes on from there")
        content = read_checkpoint(path)
        if "training" not in content:
            raise ValueError(f"{path}: expected the state of a training, got a network alone, as best.ckpt is")
        head = content[HEADER]
        state = content["training"]
        found = {"model": head["kind"], "classes": head["classes"], "seed": state["seed"]} | head["config"]
        wanted = {"model": self.model, "classes": list(train.classes), "seed": self.seed} | config.to_dict()
        for name in wanted:
            if name != "steps" and found.get(name) != wanted[name]:
                raise ValueError(f"{path}: expected a checkpoint with {name} {wanted[name]}, got {found.get(name)}")
        if features is not None and not _looks_with(content["state_dict"], features):
            raise ValueError(f"{path}: expected a checkpoint with the features of {self.features}, got other ones")
        if config.steps < state["steps"]:
            raise ValueError(f"--steps: expected at least the {state['steps']} that are taken, got {config.steps}")
        return path


def _looks_with(weights: dict[str, Tensor], features: FeatureNetwork) -> bool:
    """Whether a checkpoint's network looks at images with these features."""
    prefix = "network.encoder.features."
    found = {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}
    wanted = FeatureEncoder(features).features.state_dict()
    return found.keys() == wanted.keys() and all(torch.equal(found[name], wanted[name]) for name in wanted)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what Lightning says of itself: its advice is for those who write programs with it.

    And without what TensorBoard's thread says of a full disk, because its next record says it again.
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
