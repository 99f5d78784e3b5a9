"""Shards: samples of some models in one tar or in folders, whole or not there, with an entry in the manifest."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import tarfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...io.atomic_write import make_staging, replacing, write_file, writing
from ...io.files import read_text
from .engines import Done, Report
from .models import ModelFile, file_checksum
from .views import ModelViews, RenderModel, Sample
from .workers import JobError, Worker

SHARDS, MANIFEST, MODELS = "shards", "manifest", "models"
"""Folders of a data set: tars, entries of finished shards, and folders of models."""


@dataclass(frozen=True)
class Shard:
    """Some models of a list, in its order."""

    number: int
    models: tuple[ModelFile, ...]

    @property
    def name(self) -> str:
        return f"{self.number:06d}"


@dataclass(frozen=True)
class MakeShard:
    """Makes a `Shard` of the data set in ``folder``, a tar or, with ``layout`` "folders", a folder for each model.

    The bytes follow from the models, ``work`` and the layout. The entry in the manifest is written last; it is the
    proof that the shard is finished.
    """

    folder: Path
    work: RenderModel
    layout: str

    def __call__(self, shard: Shard, worker: Worker, report: Report) -> None:
        """Make the shard. Models that fail are noted in its entry. OSError: A file cannot be written."""
        entry: dict[str, Any] = {"shard": shard.name, "models": len(shard.models), "views": 0}
        entry |= {"samples": [], "failed": [], "notes": []}
        if self.layout == "folders":
            for model in shard.models:
                result = self._render(model, worker, report, entry)
                if result is not None:
                    rows = _write_folder(self.folder / MODELS, model.name, result)
                    entry["samples"] += [row | {"model": model.name} | result.facts for row in rows]
        else:
            path = shard_file(self.folder, shard)
            with replacing(path) as fresh:
                with tarfile.open(fresh, "w", format=tarfile.PAX_FORMAT) as tar:
                    for model in shard.models:
                        result = self._render(model, worker, report, entry)
                        if result is not None:
                            about = {"model": model.name} | result.facts
                            entry["samples"] += [_add(tar, sample) | about for sample in result.samples]
                entry |= {"bytes": fresh.stat().st_size, "sha256": file_checksum(fresh)}
        write_file(entry_file(self.folder, shard), json.dumps(entry) + "\n")

    def _render(self, model: ModelFile, worker: Worker, report: Report, entry: dict[str, Any]) -> ModelViews | None:
        """Render a model, note it in the entry and report it; return None if it failed."""
        try:
            result, _ = worker.run(self.work, model)
        except JobError as error:
            row = {"name": model.name, "path": model.path, "member": model.member, "problem": str(error)}
            entry["failed"].append(row)
            sentence = str(error) if str(error).startswith(model.name) else f"{model.name}: {error}"
            report(Done(1, failures=1, problems=(sentence,)))
            return None
        entry["views"] += result.views
        entry["notes"] += [{"name": model.name, "note": note} for note in result.notes]
        report(Done(1, result.views, seconds=result.seconds, notes=result.notes))
        return result


def _add(tar: tarfile.TarFile, sample: Sample) -> dict[str, Any]:
    """Add a sample to a tar; return its row of the index."""
    begin, digest = tar.offset, hashlib.sha256()
    for suffix, data in sample.files.items():
        info = tarfile.TarInfo(f"{sample.key}.{suffix}")  # of no time and no user: the bytes depend on the data only
        info.size = len(data)
        tar.addfile(info, io.BytesIO(data))
        digest.update(data)
    place = {"offset": begin, "bytes": tar.offset - begin}
    return {"sample": sample.key, "view": sample.view, **place, "sha256": digest.hexdigest()}


def _write_folder(root: Path, name: str, result: ModelViews) -> list[dict[str, Any]]:
    """Write the samples of a model into the folder ``name``, whole or not at all; return the rows of the index."""
    rows, folder = [], root / name
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        staging = make_staging(root)
        try:
            for sample in result.samples:
                digest, start = hashlib.sha256(), "" if sample.view is None else f"{sample.view:03d}."
                for suffix, data in sample.files.items():
                    (staging / f"{start}{suffix}").write_bytes(data)
                    digest.update(data)
                size = sum(map(len, sample.files.values()))
                row = {"sample": sample.key, "view": sample.view, "offset": None, "bytes": size}
                rows.append(row | {"sha256": digest.hexdigest()})
            os.chmod(staging, 0o755)
            shutil.rmtree(folder, ignore_errors=True)  # of an earlier run that was killed before its entry
            os.replace(staging, folder)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    return rows


def shard_file(folder: Path, shard: Shard) -> Path:
    """Return the tar of a shard."""
    return folder / SHARDS / f"{shard.name}.tar"


def entry_file(folder: Path, shard: Shard) -> Path:
    """Return the entry of a shard in the manifest."""
    return folder / MANIFEST / f"{shard.name}.json"


def read_entry(folder: Path, shard: Shard) -> dict[str, Any] | None:
    """Read the entry of a finished shard; None if it is not finished, or if what it made is missing or cut."""
    try:
        place = entry_file(folder, shard)
        entry = json.loads(read_text(place)) if place.is_file() else {}
        rows, counts = [*entry["samples"], *entry["failed"]], (entry["models"], entry["views"])
        if not all(isinstance(row, dict) for row in rows) or not all(isinstance(count, int) for count in counts):
            return None
        if "bytes" in entry and shard_file(folder, shard).stat().st_size != entry["bytes"]:
            return None
        if "bytes" not in entry:
            sizes: Counter[str] = Counter()
            for row in entry["samples"]:
                sizes[row["model"]] += row["bytes"]
            for model, size in sizes.items():
                if sum(file.stat().st_size for file in os.scandir(folder / MODELS / model)) < size:
                    return None
        return entry if entry["shard"] == shard.name else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
