"""`neural-renderer reconstruct evaluate`: evaluation of networks like the paper's Table 1."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ....io import save_image
from ....io.atomic_write import write_file
from ....version import __version__
from ...common.command import choose_device, load_network, say
from ..data.arrays import Split, open_split
from ..data.framing import VIEWS
from ..evaluation.check_axes import check_axes
from ..evaluation.evaluate import Scores, evaluate, markdown, terminal
from ..evaluation.picture import WEIGHTS, load_shape_network
from ..evaluation.predictors import Predictor, network_predictor, shape_predictor
from ..evaluation.refine import refine_steps
from ..evaluation.sheets import prediction_sheet
from ..networks.checkpoint import Model, load_model
from ..networks.shape_network import Known, ShapeNetwork
from ..options import EvaluateOptions

_LEAST_IOU = 0.35  # least IoU of the silhouettes of voxels and images; thin objects reach 0.5
_FEATURES = "googlenet"


def run(options: EvaluateOptions) -> int:
    """Evaluate the methods and write the scores; return the exit code: 0, or 130 after Ctrl-C."""
    device = choose_device(options.device)
    split = open_split(options.data, options.set, options.classes or None)
    paths = _checkpoints(options)
    models = dict(zip(method_labels(paths), (_load(path, device) for path in paths), strict=True))
    steps = {label: refine_steps(model, options.refine) for label, model in models.items()}
    predictors = {label: network_predictor(m, options.threshold, steps[label]) for label, m in models.items()}
    shapes = {label: model for label, model in models.items() if isinstance(model, ShapeNetwork)}
    parts: tuple[Known, ...] = ("camera", "view")
    given = {f"{label}, {known} given": shape_predictor(m, known) for label, m in shapes.items() for known in parts}
    _check_voxels(split)
    if options.baseline:
        predictors = {"retrieval": _retrieval(options, device)} | predictors
    methods, seconds = {}, {}
    try:
        for label, predict in (predictors | given).items():
            start = time.monotonic()
            methods[label] = _evaluate(label, predict, split, device)
            seconds[label] = round(time.monotonic() - start, 1)
    except KeyboardInterrupt:
        if not methods:
            raise
    default = options.data if paths[:1] in ([], [WEIGHTS]) else paths[0].parent
    folder = options.output or default / f"evaluation_{options.set}"
    _write(options, folder, split, methods, seconds, steps)
    finished = {label: _on_device(predict, device) for label, predict in predictors.items() if label in methods}
    save_image(folder / "sheet.png", prediction_sheet(finished, split))
    _print(methods, seconds, folder)
    return 0 if len(methods) == len(predictors | given) else 130


def _checkpoints(options: EvaluateOptions) -> list[Path]:
    first = {"none": [], "shipped": [WEIGHTS]}.get(options.checkpoint, [Path(options.checkpoint)])
    return first + list(options.also)


def _load(path: Path, device: torch.device) -> Model | ShapeNetwork:
    """Load a checkpoint of `train`, or weights of `pretrain`."""
    return load_shape_network(path) if path.suffix == ".pt" else load_model(path, device)


def method_labels(paths: list[Path]) -> list[str]:
    """Choose a unique short label for each checkpoint: the last folders of its path, as many as needed."""
    for count in range(1, max((len(path.absolute().parts) for path in paths), default=1)):
        names = ["/".join(path.absolute().parts[-1 - count : -1]) or path.stem for path in paths]
        labels = ["shipped" if path == WEIGHTS else name for path, name in zip(paths, names, strict=True)]
        if len(set(labels)) == len(paths):
            return labels
    return [f"{path} ({number})" for number, path in enumerate(paths, 1)]


def _check_voxels(split: Split) -> None:
    """Warn about classes whose voxels do not match their images."""
    for name in split.classes:
        iou, axes = check_axes(split, name) if name in split.voxels else (1.0, None)
        if axes is not None or iou < _LEAST_IOU:
            advice = "" if axes is None else f"; with the axes {axes} they would match"
            say(f"{name}: the silhouettes of voxels and images differ, unlike the published data{advice}", "yellow")


def _retrieval(options: EvaluateOptions, device: torch.device) -> Predictor:
    from ..evaluation.retrieval import Retrieval

    data = open_split(options.data, "train", options.classes or None)
    retrieval = Retrieval(data, load_network(options.features or _FEATURES, "--features").to(device))
    with _progress() as progress:
        task = progress.add_task("features of the training images", total=VIEWS * len(data))
        for done in retrieval.prepare():
            progress.update(task, completed=done)
    return retrieval.predictor()


def _evaluate(label: str, predict: Predictor, split: Split, device: torch.device) -> Scores:
    """Evaluate one method with a progress bar."""
    with _progress() as progress:
        task = progress.add_task(label, total=len(split))
        scores = Scores()
        for name, row, values in evaluate(predict, split, device):
            scores.objects.setdefault(name, {})[row] = values
            progress.advance(task)
    return scores


@contextmanager
def _progress() -> Iterator[Progress]:
    """Open a progress bar on standard error."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as progress:
        yield progress


def _on_device(predict: Predictor, device: torch.device) -> Predictor:
    """Wrap a method so that it moves images to a device."""
    return lambda images: predict(images.to(device))


def _write(
    options: EvaluateOptions,
    folder: Path,
    split: Split,
    methods: dict[str, Scores],
    seconds: dict[str, float],
    steps: dict[str, int],
) -> None:
    report = {
        "version": __version__,
        "data": str(options.data),
        "set": options.set,
        "objects": {name: len(split.images[name]) for name in split.classes},
        "checkpoints": [str(path) for path in _checkpoints(options)],
        "threshold": options.threshold,
        "refine": steps,
        "features": (options.features or _FEATURES) if options.baseline else None,
        "seconds": seconds,
        "methods": {label: scores.to_dict() for label, scores in methods.items()},
    }
    write_file(folder / "scores.json", json.dumps(report, indent=1) + "\n")
    write_file(folder / "table.md", markdown(methods))


def _print(methods: dict[str, Scores], seconds: dict[str, float], folder: Path) -> None:
    """Print the table of voxel IoU and a line per method."""
    console = Console()
    for table in terminal(methods, width=console.width):
        console.print(table)
    for label, scores in methods.items():
        measures = f"silhouette IoU {scores.mean('silhouette_iou'):.4f}, chamfer {scores.mean('chamfer'):.4f}"
        say(f"{label}: {measures}, {seconds[label]} s")
    say(f"the results are in {folder}")
