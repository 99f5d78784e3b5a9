"""Data sets of views: their shards, the state of these, and the files that describe the whole."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...camera.files.load import load_cameras
from ...camera.files.opencv import camera_rows
from ...io.atomic_write import replacing, sweep, write_file
from ...io.files import read_text, short
from ...version import __version__
from .engines import Done, Engine, Watch
from .models import ModelFile, file_checksum, load_parquet
from .shards import MANIFEST, MODELS, SHARDS, MakeShard, Shard, read_entry
from .views import RenderModel, ViewSettings

DESCRIPTION, FAILED = "dataset.json", "failed.jsonl"
_MOST_MODELS = 64  # of a shard by default
_SHARDS = 64  # least number of shards by default, so that all workers are busy
_ROWS = 50_000  # of a group of the index
_COLUMNS = ("sample", "model", "view", "shard", "offset", "bytes", "sha256", "model_sha256", "vertices", "faces")
_WHOLE = ("view", "offset", "bytes", "vertices", "faces")  # columns of whole numbers


@dataclass(frozen=True)
class DataSet:
    """Data set of the views of models in a folder."""

    folder: Path
    models: Sequence[ModelFile]  # sorted by name
    settings: ViewSettings
    layout: str  # "shards", tars in the layout of WebDataset, or "folders", one for each model
    per_shard: int | None  # models of a shard; None for 64, or fewer where that makes fewer than 64 shards
    index: str  # format of the index of samples: "parquet" or "csv"

    def shards(self) -> list[Shard]:
        """Divide the models into shards. The division follows from the list and ``per_shard`` only."""
        size = self.per_shard or max(1, min(_MOST_MODELS, -(-len(self.models) // _SHARDS)))
        starts = range(0, len(self.models), size)
        return [Shard(number, tuple(self.models[start : start + size])) for number, start in enumerate(starts)]

    def describe(self) -> None:
        """Write ``dataset.json``; ValueError if there is one of another data set, with a difference."""
        if self.index == "parquet":
            load_parquet(self.folder / "index.parquet")
        digest = hashlib.sha256()
        for model in self.models:
            digest.update(f"{model.name}\0{model.path}\0{model.member}\n".encode(errors="surrogatepass"))
        plan, environment = self.settings.cameras, self.settings.environment
        wanted = {
            "version": __version__,
            "models": len(self.models),
            "list": digest.hexdigest(),
            "shards": len(self.shards()),
            "layout": self.layout,
            "index": self.index,
            **asdict(self.settings),
        }
        if plan.is_file:  # their content, as paths stay when files change
            rows = camera_rows(load_cameras(Path(plan.kind), self.settings.size)[0], self.settings.size)
            wanted["cameras_sha256"] = hashlib.sha256(json.dumps(rows).encode()).hexdigest()
        if environment is not None:
            wanted["environment_sha256"] = file_checksum(Path(environment))
        wanted = json.loads(json.dumps(wanted))
        path = self.folder / DESCRIPTION
        if not path.is_file():
            write_file(path, json.dumps(wanted, indent=1) + "\n")
            return
        try:
            found = json.loads(read_text(path))
            different = [name for name in wanted if found.get(name) != wanted[name]]
        except (ValueError, AttributeError, RecursionError):
            raise ValueError(f"{path}: expected the description of a data set, got another file") from None
        for name in different:
            raise ValueError(
                f"{path}: expected an earlier run with {name} {wanted[name]}, got {short(found.get(name))}; choose "
                "another folder"
            )

    def make(self, engine: Engine, watch: Watch, share: tuple[int, int] = (0, 1)) -> Done:
        """Make the unfinished shards of a ``share`` (number, count); return the statistics of the finished ones."""
        before, missing = Done(), []
        for shard in self.shards()[share[0] :: share[1]]:
            entry = read_entry(self.folder, shard)
            if entry is None:
                missing.append(shard)
            else:
                before.add(Done(entry["models"], entry["views"], len(entry["failed"])))
        if before.models:
            watch("before", before)
        perform = MakeShard(self.folder, RenderModel(self.settings), self.layout)
        with closing(engine.run(perform, missing, watch)) as finished:
            for _ in finished:
                pass
        return before

    def summarize(self) -> bool:
        """Write ``failed.jsonl`` and, if all shards are finished, index and ``manifest.json``; return if they are."""
        failed, finished, views = [], [], 0
        shards = self.shards()
        for shard in shards:
            entry = read_entry(self.folder, shard)
            if entry is not None:
                failed += entry["failed"]
                views += entry["views"]
                finished.append(
                    {name: entry[name] for name in ("shard", "models", "views", "bytes", "sha256") if name in entry}
                )
        write_file(self.folder / FAILED, "".join(f"{json.dumps(row)}\n" for row in sorted(failed, key=_name)))
        if len(finished) < len(shards):
            return False
        index = self.folder / f"index.{self.index}"
        (_write_parquet if self.index == "parquet" else _write_csv)(index, self._rows(shards))
        totals = {"models": len(self.models), "failed": len(failed), "views": views}
        write_file(self.folder / "manifest.json", json.dumps({**totals, "shards": finished}, indent=1) + "\n")
        for place in (SHARDS, MANIFEST, MODELS):
            if (self.folder / place).is_dir():
                sweep(self.folder / place, others=True)
        return True

    def _rows(self, shards: Sequence[Shard]) -> Iterator[dict[str, Any]]:
        for shard in shards:
            entry = read_entry(self.folder, shard)
            for row in entry["samples"] if entry is not None else ():
                yield row | {
                    "shard": f"{SHARDS}/{shard.name}.tar" if self.layout == "shards" else f"{MODELS}/{row['model']}"
                }


def _name(row: dict[str, Any]) -> str:
    return str(row.get("name"))


def _write_csv(path: Path, rows: Iterator[dict[str, Any]]) -> None:
    with replacing(path) as fresh, fresh.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, _COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _write_parquet(path: Path, rows: Iterator[dict[str, Any]]) -> None:
    """Write the index in groups of rows, so that its length does not matter."""
    parquet = load_parquet(path)
    import pyarrow

    kinds = {name: pyarrow.int64() if name in _WHOLE else pyarrow.string() for name in _COLUMNS}
    schema = pyarrow.schema(list(kinds.items()))
    with replacing(path) as fresh, parquet.ParquetWriter(fresh, schema) as writer:
        group: list[dict[str, Any]] = []
        for row in rows:
            group.append(row)
            if len(group) == _ROWS:
                writer.write_table(pyarrow.Table.from_pylist(group, schema))
                group = []
        writer.write_table(pyarrow.Table.from_pylist(group, schema))
