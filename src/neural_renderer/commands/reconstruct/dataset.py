"""`neural-renderer reconstruct dataset`: from a folder of 3D models to data that a network is trained on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from ...io import save_image
from ...tasks.reconstruction.data.arrays import SPLITS, open_split
from ...tasks.reconstruction.data.dataset import Settings, assemble, existing_names, make_objects
from ...tasks.reconstruction.data.models_folder import Model, default_splits, find_models, read_splits
from ...tasks.reconstruction.evaluation.check_axes import check_axes
from ...tasks.reconstruction.evaluation.sheets import data_sheet
from ..common import checked_count, output_folder
from ..options.reconstruct.dataset import DatasetOptions


@dataclass(frozen=True)
class Dataset(DatasetOptions):
    """Makes the data, as the options say."""

    def run(self) -> int:
        """Make the data; returns the exit code: 0, or 130 after Ctrl-C. Raises ValueError or OSError."""
        for name, least in {"views": 1, "size": 8, "samples": 4, "processes": 0}.items():
            checked_count(name, getattr(self, name), least)
        if self.splits is not None and self.set is not None:
            raise ValueError("--set: expected it alone or --splits alone, got both")
        models, broken = find_models(self.models)
        chosen = self._chosen(models, broken)
        self._check_splits(chosen)
        settings = Settings(self.views, self.size, self.samples)
        console = Console()
        output_folder("OUT", self.out)
        if not self._make([model for model in models if (model.category, model.name) in chosen], settings, broken):
            console.print(f"interrupted; the same command goes on, with what is in {self.out}", highlight=False)
            return 130
        splits: dict[str, dict[str, list[Model]]] = {}
        for model in models:
            split = chosen.get((model.category, model.name))
            if split is not None and f"{model.category}/{model.name}" not in broken:
                splits.setdefault(split, {}).setdefault(model.category, []).append(model)
        if not splits:
            raise ValueError(f"{self.models}: expected at least one model that can be rendered, got none")
        assemble(self.out, splits, settings, broken)
        self._report(console, splits, broken, len(models) - len(chosen))
        return 0

    def _chosen(self, models: list[Model], broken: dict[str, str]) -> dict[tuple[str, str], str]:
        """The split of each model that is to be made."""
        keys = {(model.category, model.name) for model in models}
        if self.set is not None:
            return dict.fromkeys(keys, self.set)
        if self.splits is None:
            return default_splits(models)
        given = read_splits(self.splits)
        for category, name in sorted(given.keys() - keys):
            broken.setdefault(f"{category}/{name}", f"{self.models}: expected {category}/{name}, got no such model")
        chosen = {key: split for key, split in given.items() if key in keys}
        if not chosen:
            raise ValueError(f"{self.splits}: expected models of {self.models}, got none of them")
        return chosen

    def _check_splits(self, chosen: dict[tuple[str, str], str]) -> None:
        """No object may be in two splits, one of them from an earlier run."""
        for earlier, classes in existing_names(self.out).items():
            for category, names in classes.items():
                for name in names:
                    now = chosen.get((category, name), earlier)
                    if now != earlier:
                        raise ValueError(
                            f"{self.out}: expected a folder in which {category}/{name} is in {now}, got one that has "
                            f"it in {earlier}; choose another folder"
                        )

    def _make(self, models: list[Model], settings: Settings, broken: dict[str, str]) -> bool:
        """Make the objects with progress; False after Ctrl-C."""
        console = Console(stderr=True)
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
            task = progress.add_task("objects", total=len(models))
            try:
                for model, problem, notes in make_objects(
                    models, self.out, settings, self.processes, self.allow_outside
                ):
                    for text in notes:
                        progress.console.print(text, style="yellow", markup=False, soft_wrap=True)
                    if problem is not None:
                        broken[f"{model.category}/{model.name}"] = problem
                        progress.console.print(problem, style="red", markup=False, soft_wrap=True)
                    progress.advance(task)
            except KeyboardInterrupt:
                return False
        return True

    def _report(
        self, console: Console, splits: dict[str, dict[str, list[Model]]], broken: dict[str, str], left_out: int
    ) -> None:
        table = Table("class", *SPLITS)
        counts = {split: Counter({n: len(m) for n, m in classes.items()}) for split, classes in splits.items()}
        names = sorted({name for classes in splits.values() for name in classes})
        for name in names:
            table.add_row(name, *(str(counts[split][name]) if split in counts else "" for split in SPLITS))
        table.add_row("all", *(str(counts[split].total()) if split in counts else "" for split in SPLITS))
        console.print(table)
        if (self.views, self.size) == (24, 64):
            lowest = 1.0
            for split, classes in splits.items():
                data = open_split(self.out, split, sorted(classes))
                for name in classes:
                    save_image(self.out / "sheets" / f"{name}_{split}.png", data_sheet(data, name))
                    lowest = min(lowest, check_axes(data, name)[0])
            text = f"outlines of voxels and images agree to an IoU of at least {lowest:.2f} in every class"
            console.print(f"{text}; look at {self.out / 'sheets'}", highlight=False, soft_wrap=True)
        if left_out:
            console.print(f"{left_out} models are not in {self.splits}", highlight=False, soft_wrap=True)
        if broken:
            console.print(f"[red]{len(broken)} models are left out; dataset.json says why[/red]", highlight=False)
