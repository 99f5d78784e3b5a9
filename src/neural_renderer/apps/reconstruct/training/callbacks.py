"""Lightning callbacks: checkpoints, logs, pictures, the progress bar, observers, and the end of a training."""

from __future__ import annotations

import csv
import os
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import lightning
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from torch import Tensor

from ....io import save_image
from ....io.atomic_write import replacing, writing
from ...common.observer import LEAST_RATE, Knob, Observer, goes_on
from ..data.arrays import Split
from ..evaluation.predict import predict_meshes
from ..evaluation.predictors import network_predictor
from ..evaluation.sheets import training_sheet
from ..networks.checkpoint import BEST, LAST, save_model

STOPPED = 0
"""Appended to the list of interruptions when the observer stops a training; Ctrl-C appends another number."""
_MOST = 4  # predictions shown
_VIEW = 2  # index of the view shown, among the 24 of an object
_AVERAGED = ("loss", "iou")  # over the processes' shares of a batch
_LOG_EVERY = 10  # steps between two rows of the log


class Checkpoints(lightning.Callback):
    """Writes checkpoints after each round, and ends the training in all processes together.

    "last.ckpt" is the state from which a training resumes. "best.ckpt" is the network with the best silhouette IoU on
    the validation split, or the last network if there is no such split. The training ends when the list ``interrupted``
    is not empty.
    """

    def __init__(self, folder: Path, interrupted: list[int]) -> None:
        self._folder, self._interrupted = folder, interrupted
        self.best = -1.0

    def on_train_batch_end(self, trainer: lightning.Trainer, module: Any, *_: Any) -> None:
        """Average the losses of all processes; stop all if the training is done or interrupted in one of them."""
        state = torch.tensor([module.progress, float(bool(self._interrupted))], dtype=torch.float64)
        if trainer.world_size > 1:  # clocks differ, and Ctrl-C may reach one process only
            state = state.to(module.device)
            torch.distributed.all_reduce(state, torch.distributed.ReduceOp.MAX)
            means = state.new_tensor([module.latest[name] for name in _AVERAGED]) / trainer.world_size
            torch.distributed.all_reduce(means)
            module.latest |= zip(_AVERAGED, means.tolist(), strict=True)
        module.progress = float(state[0])
        if module.done or state[1]:
            trainer.should_stop = True

    def on_train_epoch_end(self, trainer: lightning.Trainer, module: Any) -> None:
        """Write the checkpoints."""
        score = module.latest.get("val_iou", self.best)
        if trainer.is_global_zero and (score > self.best or module.val_split is None):
            self.best = score
            facts = {"steps": module.steps_done, "seconds": module.seconds}
            facts |= {} if module.val_split is None else {"val_iou": score}
            save_model(self._folder / BEST, module.model, module.train_split.classes, **facts)
        # All processes must call `save_checkpoint`; one of them writes.
        path = self._folder / LAST
        with replacing(path) if trainer.is_global_zero else nullcontext(path) as fresh:
            trainer.save_checkpoint(fresh, weights_only=False)

    def state_dict(self) -> dict[str, Any]:
        return {"best": self.best}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.best = state_dict["best"]


class Log(lightning.Callback):
    """Writes numbers to "log.csv" and TensorBoard, pictures to "pictures", and shows a progress bar."""

    _COLUMNS = ("step", "seconds", "rate", "loss", "iou", "val_iou")

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._progress: Progress | None = None

    def on_train_start(self, trainer: lightning.Trainer, module: Any) -> None:
        """Start the log and the progress bar; keep rows of the log up to the checkpoint."""
        if not trainer.is_global_zero:
            return
        path = self._folder / "log.csv"
        rows = []
        if module.steps_done and path.is_file():  # steps after the checkpoint will be repeated
            with path.open(newline="", encoding="utf-8") as file:
                whole = [row for row in csv.DictReader(file) if None not in row.values()]  # a kill may truncate a row
                rows = [row for row in whole if int(row["step"]) <= module.steps_done]
        with replacing(path) as fresh, fresh.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._COLUMNS, extrasaction="ignore", lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        note = TextColumn("{task.fields[note]}")
        self._progress = Progress(TextColumn("training"), BarColumn(), note, console=Console())
        self._task = self._progress.add_task("training", total=1.0, note="")
        self._progress.start()
        self._start = module.progress, module.seconds

    def on_train_batch_end(self, trainer: lightning.Trainer, module: Any, *_: Any) -> None:
        """Update the progress bar, and write every tenth step to the log."""
        if self._progress is None:
            return
        done, seconds = module.progress - self._start[0], module.seconds - self._start[1]
        left = seconds / max(done, 1e-9) * max(1 - module.progress, 0)
        note = f"step {module.steps_done}  loss {module.latest['loss']:.4f}  IoU {module.latest['iou']:.4f}"
        if "val_iou" in module.latest:
            note += f"  val IoU {module.latest['val_iou']:.4f}"
        self._progress.update(self._task, completed=min(module.progress, 1.0), note=f"{note}  {_duration(left)} left")
        if module.steps_done % _LOG_EVERY == 0:
            self._write(trainer, module, ("loss", "iou"))

    def on_validation_end(self, trainer: lightning.Trainer, module: Any) -> None:
        """Write the score of the validation and a picture of predictions."""
        if self._progress is None or "val_iou" not in module.latest:
            return
        self._write(trainer, module, ("val_iou",))
        predict = network_predictor(module.model)
        sheet = training_sheet(lambda images: predict(images.to(module.device)), module.val_split)
        save_image(self._folder / "pictures" / f"{module.steps_done:08d}.png", sheet)
        for logger in trainer.loggers:
            with writing(self._folder / "tensorboard"):
                logger.experiment.add_image("predictions", sheet, module.steps_done)  # type: ignore[attr-defined]

    def on_train_end(self, trainer: lightning.Trainer, module: Any) -> None:
        self._stop()

    def on_exception(self, trainer: lightning.Trainer, module: Any, exception: BaseException) -> None:
        self._stop()

    def _stop(self) -> None:
        """Stop the progress bar."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None

    def _write(self, trainer: lightning.Trainer, module: Any, names: tuple[str, ...]) -> None:
        """Append the latest values of these names to the log and to TensorBoard."""
        rate = trainer.optimizers[0].param_groups[0]["lr"]
        row = {"step": module.steps_done, "seconds": round(module.seconds, 2), "rate": f"{rate:.3g}"}
        row |= {name: round(module.latest[name], 6) for name in names}
        path = self._folder / "log.csv"
        with (
            writing(path),
            path.open("r+", newline="", encoding="utf-8") as file,
        ):  # "a" could create a log without header
            file.seek(0, os.SEEK_END)
            csv.DictWriter(file, self._COLUMNS, lineterminator="\n").writerow(row)
        values = {name: module.latest[name] for name in names} | {"rate": rate}
        for logger in trainer.loggers:
            with writing(self._folder / "tensorboard"):
                logger.log_metrics(values, step=module.steps_done)


def _duration(seconds: float) -> str:
    """Format a duration as hours:minutes:seconds."""
    hours, rest = divmod(int(seconds), 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}"


class Watch(lightning.Callback):
    """Shows the steps of a training to an observer, and applies its changes; a stop goes into ``interrupted``."""

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

    def _predict(self, module: Any) -> dict[str, tuple[Tensor, Tensor]]:
        """Predict a mesh for each of the pictures."""
        model, found = module.model, {}
        was_training = model.training
        model.eval()
        try:
            for name, image in self._images.items():
                try:
                    [found[name]] = predict_meshes(model, image[None].to(module.device))
                except ValueError:  # all voxels are empty, as at the start of a training
                    continue
        finally:
            model.train(was_training)
        return found


def some_images(split: Split) -> dict[str, Tensor]:
    """Choose a picture [4, 64, 64] uint8 of each class, up to four, by name."""
    return {name: torch.from_numpy(split.images[name][0][_VIEW].copy()) for name in split.classes[:_MOST]}
