"""Jobs of `neural-renderer batch`: rows of a table as command lines, run in worker processes."""

from __future__ import annotations

import contextlib
import importlib
import json
import re
import shlex
import typing
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from ....io.atomic_write import write_file
from ....io.files import read_text, short, warn
from ...commands import COMMANDS
from ...common.checks import CHECKPOINT, REPORT
from ..engines import Done, Report
from ..models import plain_names, read_table
from ..workers import JobError, Worker

MANIFEST = "manifest"
_RESULTS = (REPORT, "mesh.obj")  # files that the table and the sheet of all runs need
_BOX = re.compile("[\u2500-\u257f]+")  # lines that tyro draws around its messages
_GIVEN = ("output", "resume", "force", "watch")  # options that the batch sets
_FINISHED = (0, 3)  # exit codes of runs with results; 3: outlines that do not match
_YES, _NO = ("true", "yes", "1"), ("false", "no", "0")


@dataclass(frozen=True)
class Job:
    """Run of a command: its name, also that of its folder, and its arguments without the output."""

    name: str
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class DoJob:
    """Does a job of ``command`` with results in ``folder``/name; its entry in the manifest is written last."""

    folder: Path
    command: str

    def __call__(self, job: Job, worker: Worker, report: Report) -> None:
        """Run the command; a failure is noted in the entry."""
        entry: dict[str, Any] = {"name": job.name, "arguments": job.arguments, "code": None, "problem": None}
        place, earlier = self.folder / job.name, _earlier(self.folder, job)
        if earlier is not None and earlier["problem"]:  # that run had other arguments
            (place / CHECKPOINT).unlink(missing_ok=True)
        try:
            entry["code"], _ = worker.run(self._run, job)
            entry["files"] = [name for name in _RESULTS if (place / name).is_file()]
            report(Done(1))
        except JobError as error:
            entry["problem"] = str(error)
            report(Done(1, failures=1, problems=(f"{job.name}: {error}",)))
        write_file(entry_file(self.folder, job), json.dumps(entry, indent=1) + "\n")

    def _run(self, job: Job) -> int:
        """Run the command in this process, with its output in log.txt; return the exit code.

        ValueError: The arguments are wrong, or the command was interrupted; or an error of the command.
        """
        folder = self.folder / job.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "log.txt").unlink(missing_ok=True)  # it may be a link
        with (
            (folder / "log.txt").open("w", encoding="utf-8") as log,
            contextlib.redirect_stdout(log),
            contextlib.redirect_stderr(log),
        ):
            try:
                arguments = [*job.arguments, "--output", str(folder), "--resume", "--force"]
                chosen: Any = tyro.cli(_options_of(self.command), args=arguments)
                chosen.validate()
                code = importlib.import_module(f"neural_renderer.apps.{COMMANDS[self.command].module}").run(chosen)
            except SystemExit:
                log.flush()
                words = " ".join(_BOX.sub(" ", (folder / "log.txt").read_text(encoding="utf-8")).split())
                raise ValueError(
                    f"expected options of {self.command}, got {short(shlex.join(job.arguments))}: {words}"
                ) from None
        if code not in _FINISHED:
            raise ValueError(f"expected a finished run, got exit code {code}")
        return int(code)


def read_jobs(path: Path, command: str) -> list[Job]:
    """Read the jobs of a command from a .csv, one a row, in its order; ValueError if it is malformed.

    The name of a column is that of an option, such as steps or detail-steps, or of a positional argument, such as
    images or mesh. Empty cells are skipped. Several values in a cell are separated by spaces. The column "name" gives
    the folder of the results, by default the name of the first positional argument. Paths are relative to the folder of
    the table.
    """
    kinds = typing.get_type_hints(_options_of(command), include_extras=True)
    positional = [name for name, kind in kinds.items() if tyro.conf.Positional in getattr(kind, "__metadata__", ())]
    header, table = read_table(path)
    if not table:
        raise ValueError(f"{path}: expected a header and one row or more, got none")
    known = {name.replace("_", "-") for name in kinds} - set(_GIVEN)
    for column in header:
        if column != "name" and column.partition(".")[0].replace("_", "-") not in known:
            raise ValueError(f"{path}: expected columns name, {', '.join(sorted(known))}, got {short(column)}")
    names, rows = [], []
    for number, row, problem in table:
        missing = [name for name in positional if not row.get(name)]
        if problem or missing:
            expected = problem or f"expected a value in the column {missing[0]!r}, got none"
            raise ValueError(f"{path}, line {number}: {expected}")
        first = Path(row[positional[0]])
        names.append(row.get("name") or (first.stem if first.suffix else first.name))
        if Path(names[-1]).parts[:1] == (MANIFEST,):
            raise ValueError(
                f"{path}, line {number}: expected another name, got {short(names[-1])}, the folder of the batch"
            )
        rows.append(_arguments(path.resolve().parent, row, kinds, positional))
    if any(row.get("name") for _, row, _ in table) and len(set(names)) != len(names):
        twice = next(name for name, count in Counter(names).items() if count > 1)
        raise ValueError(f"{path}: expected names that differ, got {short(twice)} twice")
    folders = plain_names([name.replace(".", "_") for name in names])
    given = [row.get("name") or folder for folder, (_, row, _) in zip(folders, table, strict=True)]
    if renamed := [f"{name} is {folder}" for name, folder in zip(given, folders, strict=True) if name != folder]:
        warn(f"{path}: expected names of letters, digits, _ and -, got others; {short(', '.join(renamed))}")
    return [Job(name, row) for name, row in zip(folders, rows, strict=True)]


def entry_file(folder: Path, job: Job) -> Path:
    """Return the entry of a finished job in the manifest."""
    return folder / MANIFEST / f"{job.name}.json"


def read_entry(folder: Path, job: Job) -> dict[str, Any] | None:
    """Read the entry of a finished job. None: there is none, its results are gone, or it failed with other arguments.

    ValueError: The finished job of an earlier run had other arguments.
    """
    entry = _earlier(folder, job)
    if entry is None or not all((folder / job.name / name).is_file() for name in entry.get("files", ())):
        return None
    before = tuple(entry["arguments"])
    if before != job.arguments:
        if entry["problem"]:
            return None
        raise ValueError(
            f"{folder}: expected {job.name} with the arguments of an earlier run, {shlex.join(before)}, got "
            f"{shlex.join(job.arguments)}; choose another name or folder"
        )
    return entry


def _earlier(folder: Path, job: Job) -> dict[str, Any] | None:
    """Read the entry of a job, or None; it may be of other arguments."""
    try:
        place = entry_file(folder, job)
        entry = json.loads(read_text(place)) if place.is_file() else {}
        names = [*entry["arguments"], *entry.get("files", ())]
        is_whole = all(isinstance(name, str) for name in names) and (entry["problem"] or "code" in entry)
        return entry if is_whole else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _options_of(command: str) -> type:
    module = importlib.import_module(f"neural_renderer.apps.{COMMANDS[command].options}")
    return getattr(module, f"{command.capitalize()}Options")


def _arguments(home: Path, row: dict[str, str], kinds: dict[str, Any], positional: Sequence[str]) -> tuple[str, ...]:
    """Convert a row to the arguments of a command."""

    def values(name: str, text: str) -> list[str]:
        parts = shlex.split(text) if "tuple" in str(kinds[name]) else [text]
        return [str(home / part) for part in parts] if "Path" in str(kinds[name]) else parts

    arguments = [value for name in positional for value in values(name, row[name])]
    for column, text in row.items():
        option = column.replace("-", "_")
        if not text or column == "name" or option in positional:
            continue
        flag = column.replace("_", "-")
        kind = kinds[option.partition(".")[0]]
        truth = text.lower() in _YES if text.lower() in _YES + _NO else None
        if kind is bool and truth is not None:
            arguments.append(f"--{'' if truth else 'no-'}{flag}")
        elif kind == bool | None and truth is not None:
            arguments += [f"--{flag}", str(truth)]
        else:
            arguments += [f"--{flag}", *([text] if "." in option else values(option, text))]
    return tuple(arguments)
