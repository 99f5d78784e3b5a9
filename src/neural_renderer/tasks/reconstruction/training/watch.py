"""Lightning callback for an observer of a training, such as the viewer."""

from __future__ import annotations

from typing import Any

import lightning
import torch
from torch import Tensor

from ...observer import LEAST_RATE, Knob, Observer, goes_on
from ..data.arrays import Split
from ..evaluation.predict import predict_meshes
from .training import Training

STOPPED = 0
"""Appended to the list of interruptions when the observer stops a training; Ctrl-C appends another number."""
_MOST = 4  # predictions shown
_VIEW = 2  # of the 24 of an object


class Watch(lightning.Callback):
    """Shows the steps of a training to an observer, and does what it asks for; a stop is appended to ``interrupted``."""

    def __init__(self, observer: Observer, interrupted: list[int]) -> None:
        self._observer, self._interrupted = observer, interrupted
        self._images: dict[str, Tensor] = {}

    def on_train_start(self, trainer: lightning.Trainer, module: Any) -> None:
        """Choose the pictures, and offer the learning rate."""
        if trainer.is_global_zero:
            self._images = some_images(module.val_split or module.train_split)
            self._observer.offer([Knob("rate", module.config.rate, LEAST_RATE)])

    def on_train_batch_end(self, trainer: lightning.Trainer, module: Any, *_: Any) -> None:
        """Show a step."""
        if not trainer.is_global_zero:
            return
        numbers = {name: float(module.latest[name]) for name in ("loss", "iou", "val_iou") if name in module.latest}
        steps = module.config.steps
        self._observer.observe("training", module.steps_done, steps, numbers, lambda: self._predict(module))
        rate = self._observer.changes().get("rate")
        if rate is not None:
            module.rate_factor = float(rate) / module.config.rate
        if not self._interrupted and not goes_on(self._observer, self._interrupted):
            self._interrupted.append(STOPPED)

    def _predict(self, module: Training) -> dict[str, tuple[Tensor, Tensor]]:
        """Predict a mesh for each of the pictures."""
        model, found = module.model, {}
        was_training = model.training
        model.eval()
        try:
            for name, image in self._images.items():
                try:
                    [found[name]] = predict_meshes(model, image[None].to(module.device))
                except ValueError:  # voxels, all of which are empty: at the start of a training
                    continue
        finally:
            model.train(was_training)
        return found


def some_images(split: Split) -> dict[str, Tensor]:
    """Choose a picture [4, 64, 64] uint8 of each class, up to four, by name."""
    return {name: torch.from_numpy(split.images[name][0][_VIEW].copy()) for name in split.classes[:_MOST]}
