"""`neural-renderer reconstruct dataset`: a data set from a folder of 3D models."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from ....io import save_image
from ...common.command import INTERRUPTED, say
from ...many.engines import Engine, choose_engine
from ...many.progress import Watching
from ..data.arrays import open_split
from ..data.dataset import Settings, assemble, existing_names, make_objects
from ..data.framing import SIZE, SPLITS, VIEWS
from ..data.models_folder import Model, default_splits, find_models, read_splits
from ..evaluation.check_axes import check_axes
from ..evaluation.sheets import data_sheet
from ..options import DatasetOptions

Splits = dict[str, dict[str, list[Model]]]
"""Split → class → models."""


def run(options: DatasetOptions) -> int:
    """Make a data set; return the exit code: 0, or 130 after Ctrl-C."""
    engine = choose_engine(options.engine)
    models, broken = find_models(options.models)
    chosen = _choose_splits(options, models, broken)
    _check_earlier_splits(options, chosen)
    settings = Settings(options.views, options.size, options.samples)
    if not _make(options, [model for model in models if _key(model) in chosen], settings, engine, broken):
        say(f"interrupted; the same command continues with the finished objects in {options.out}")
        return INTERRUPTED
    splits: Splits = {}
    for model in models:
        if _key(model) in chosen and f"{model.category}/{model.name}" not in broken:
            splits.setdefault(chosen[_key(model)], {}).setdefault(model.category, []).append(model)
    if not splits:
        raise ValueError(f"{options.models}: expected at least one model that can be rendered, got none")
    assemble(options.out, splits, settings, broken)
    _report(options, splits, broken, len(models) - len(chosen))
    return 0


def _key(model: Model) -> tuple[str, str]:
    return model.category, model.name


def _choose_splits(options: DatasetOptions, models: list[Model], broken: dict[str, str]) -> dict[tuple[str, str], str]:
    """Choose the split of each model, by category and name; models that are left out are missing."""
    keys = set(map(_key, models))
    if options.set is not None:
        return dict.fromkeys(keys, options.set)
    if options.splits is None:
        return default_splits(models)
    given = read_splits(options.splits)
    for category, name in sorted(given.keys() - keys):
        broken.setdefault(f"{category}/{name}", f"{options.models}: expected {category}/{name}, got no such model")
    chosen = {key: split for key, split in given.items() if key in keys}
    if not chosen:
        raise ValueError(f"{options.splits}: expected models of {options.models}, got none of them")
    return chosen


def _check_earlier_splits(options: DatasetOptions, chosen: dict[tuple[str, str], str]) -> None:
    """Raise ValueError if an earlier run has put an object into another split."""
    for earlier, classes in existing_names(options.out).items():
        for category, names in classes.items():
            for name in names:
                now = chosen.get((category, name), earlier)
                if now != earlier:
                    raise ValueError(
                        f"{options.out}: expected {category}/{name} in the split {now}, got it in {earlier} from an "
                        "earlier run; choose another folder"
                    )


def _make(
    options: DatasetOptions, models: list[Model], settings: Settings, engine: Engine, broken: dict[str, str]
) -> bool:
    """Make the objects with a progress bar, and record broken models. Returns False after Ctrl-C."""
    with Watching(len(models), "objects") as watching:
        objects = make_objects(models, options.out, settings, engine, options.allow_outside, watching)
        try:
            for model, problem, _ in objects:
                if problem is not None:
                    broken[f"{model.category}/{model.name}"] = problem
        except KeyboardInterrupt:
            return False
    return True


def _report(options: DatasetOptions, splits: Splits, broken: dict[str, str], left_out: int) -> None:
    """Print a table of the data set, write contact sheets, and check the axes of voxels."""
    table = Table("class", *SPLITS)
    counts = {split: Counter({n: len(m) for n, m in classes.items()}) for split, classes in splits.items()}
    names = sorted({name for classes in splits.values() for name in classes})
    for name in names:
        table.add_row(name, *(str(counts[split][name]) if split in counts else "" for split in SPLITS))
    table.add_row("all", *(str(counts[split].total()) if split in counts else "" for split in SPLITS))
    Console().print(table)
    if (options.views, options.size) == (VIEWS, SIZE):
        folder, lowest = options.out / "sheets", 1.0
        for split, classes in splits.items():
            data = open_split(options.out, split, sorted(classes))
            for name in classes:
                save_image(folder / f"{name}_{split}.png", data_sheet(data, name))
                lowest = min(lowest, check_axes(data, name)[0])
        say(f"IoU of the silhouettes of voxels and images: at least {lowest:.2f} in each class; see {folder}")
    if left_out:
        say(f"{left_out} models are not in {options.splits}")
    if broken:
        say(f"[red]{len(broken)} models are left out; dataset.json gives the reasons[/red]", markup=True)
