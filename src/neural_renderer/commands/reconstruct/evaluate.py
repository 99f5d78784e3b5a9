"""`neural-renderer reconstruct evaluate`: how well networks predict shapes, as the paper's Table 1 measures it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ...io import save_image
from ...io.atomic_write import write_file
from ...tasks.reconstruction.data.arrays import Split, open_split
from ...tasks.reconstruction.evaluation.check_axes import check_axes
from ...tasks.reconstruction.evaluation.evaluate import Scores, evaluate
from ...tasks.reconstruction.evaluation.predictors import Predictor, network_predictor
from ...tasks.reconstruction.evaluation.refine import refine_steps
from ...tasks.reconstruction.evaluation.sheets import prediction_sheet
from ...tasks.reconstruction.evaluation.tables import markdown, terminal
from ...tasks.reconstruction.networks.checkpoint import load_model
from ...version import __version__
from ..common import checked_count, chosen_device
from ..options.reconstruct.evaluate import EvaluateOptions

_LEAST_AGREEMENT = 0.35  # thin objects reach 0.5


@dataclass(frozen=True)
class Evaluate(EvaluateOptions):
    """Measures networks, as the options say."""

    def run(self) -> int:
        """Measure; returns the exit code: 0, or 130 after Ctrl-C. Raises ValueError or OSError."""
        if not 0 < self.threshold < 1:
            raise ValueError(f"--threshold: expected a number above 0 and below 1, got {self.threshold}")
        if self.refine is not None:
            checked_count("refine", self.refine, 0)
        if self.checkpoint == "none" and not (self.also or self.baseline):
            raise ValueError("checkpoint: expected a network or --baseline retrieval, got none of them")
        if self.features is not None and not self.baseline:
            raise ValueError(f"--features: expected --baseline retrieval with it, got {self.features} alone")
        device = chosen_device(self.device)
        split = open_split(self.data, self.set, self.classes or None)
        paths = ([] if self.checkpoint == "none" else [Path(self.checkpoint)]) + list(self.also)
        models = dict(zip(_labels(paths), (load_model(path, device) for path in paths), strict=True))
        steps = {label: refine_steps(model, self.refine) for label, model in models.items()}
        predictors = {label: network_predictor(model, self.threshold, steps[label]) for label, model in models.items()}
        console = Console()
        self._check(console, split)
        if self.baseline:
            predictors = {"retrieval": self._retrieval(split, device)} | predictors
        methods, seconds = {}, {}
        try:
            for label, predict in predictors.items():
                begun = time.monotonic()
                methods[label] = _measured(label, predict, split, device)
                seconds[label] = round(time.monotonic() - begun, 1)
        except KeyboardInterrupt:
            if not methods:
                raise
        self._write(console, split, {label: predictors[label] for label in methods}, methods, seconds, paths, steps)
        return 0 if len(methods) == len(predictors) else 130

    def _check(self, console: Console, split: Split) -> None:
        """Warn where voxels and images of a folder do not belong together."""
        for name in split.classes:
            fit, axes = check_axes(split, name) if name in split.voxels else (1.0, None)
            if axes is not None or fit < _LEAST_AGREEMENT:
                seem = "" if axes is None else f"; with the axes {axes} they would"
                text = f"{name}: the outlines of voxels and images do not agree as in the published data{seem}"
                console.print(text, style="yellow", highlight=False, soft_wrap=True)

    def _retrieval(self, split: Split, device: torch.device) -> Predictor:
        from ...features import load_features
        from ...tasks.reconstruction.evaluation.retrieval import Retrieval

        train = open_split(self.data, "train", self.classes or None)
        retrieval = Retrieval(train, load_features(self.features or "googlenet").to(device))
        with _progress() as progress:
            task = progress.add_task("features of the training images", total=24 * len(train))
            for done in retrieval.prepare():
                progress.update(task, completed=done)
        return retrieval.predictor()

    def _write(
        self,
        console: Console,
        split: Split,
        predictors: dict[str, Predictor],
        methods: dict[str, Scores],
        seconds: dict[str, float],
        paths: list[Path],
        steps: dict[str, int],
    ) -> None:
        folder = self.output or (paths[0].parent if paths else self.data) / f"evaluation_{self.set}"
        report = {
            "version": __version__,
            "data": str(self.data),
            "set": self.set,
            "objects": {name: len(split.images[name]) for name in split.classes},
            "checkpoints": [str(path) for path in paths],
            "threshold": self.threshold,
            "refine": steps,
            "features": (self.features or "googlenet") if self.baseline else None,
            "seconds": seconds,
            "methods": {label: scores.to_dict() for label, scores in methods.items()},
        }
        for name, text in {"scores.json": json.dumps(report, indent=1) + "\n", "table.md": markdown(methods)}.items():
            write_file(folder / name, text)
        for table in terminal(methods, width=console.width):
            console.print(table)
        for label, scores in methods.items():
            others = f"silhouette IoU {scores.mean('silhouette_iou'):.4f}, chamfer {scores.mean('chamfer'):.4f}"
            console.print(f"{label}: {others}, {seconds[label]} s", highlight=False)
        cpu = {label: _on(predict, chosen_device(self.device)) for label, predict in predictors.items()}
        save_image(folder / "sheet.png", prediction_sheet(cpu, split))
        console.print(f"the results are in {folder}", highlight=False, soft_wrap=True)


def _measured(label: str, predict: Predictor, split: Split, device: torch.device) -> Scores:
    with _progress() as progress:
        task = progress.add_task(label, total=len(split))
        scores = Scores()
        for name, row, values in evaluate(predict, split, device):
            scores.objects.setdefault(name, {})[row] = values
            progress.advance(task)
    return scores


@contextmanager
def _progress() -> Iterator[Progress]:
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as progress:
        yield progress


def _on(predict: Predictor, device: torch.device) -> Predictor:
    return lambda images: predict(images.to(device))


def _labels(paths: list[Path]) -> list[str]:
    """A short name for each checkpoint, no two alike: its folder's, or as much of its path as tells them apart."""
    for count in range(1, max((len(path.absolute().parts) for path in paths), default=1)):
        labels = ["/".join(path.absolute().parts[-1 - count : -1]) or path.stem for path in paths]
        if len(set(labels)) == len(paths):
            return labels
    return [f"{path} ({number})" for number, path in enumerate(paths, 1)]
