"""Checks, messages and progress of the commands."""

from __future__ import annotations

import errno
import math
import os
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ...io.named_files import names_file
from .features import FeatureNetwork, load_features

_LINES = 4  # lines of a phase in a file that shows progress, beside that of its start
CHECKPOINT, REPORT = "checkpoint.pt", "report.json"
"""Files in the folder of a run."""
MISMATCH = 3
"""Exit code of a command whose result is doubtful: it does not agree with the pictures, or they say too little."""


def choose_device(name: str) -> torch.device:
    """Choose a device by the name "cpu", "cuda" or "auto". Raises ValueError if CUDA is requested and missing."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device: expected cpu, got cuda, but torch finds no CUDA device here")
    return torch.device(name)


def check_counts(options: Any, **least: int) -> None:
    """Raise ValueError if an option is below its least value, given by keyword. Options that are None are skipped."""
    for name, limit in least.items():
        value = getattr(options, name)
        if value is not None and value < limit:
            raise ValueError(f"--{name.replace('_', '-')}: expected at least {limit}, got {value}")


def check_most(options: Any, **most: int) -> None:
    """Raise ValueError if an option is above its greatest value, given by keyword; None is skipped."""
    for name, limit in most.items():
        value = getattr(options, name)
        if value is not None and value > limit:
            raise ValueError(f"--{name.replace('_', '-')}: expected at most {limit}, got {value}")


def check_between(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError if an option is not above ``low`` and below ``high``."""
    if not low < value < high:
        limit = f" and below {high}" if math.isfinite(high) else ""
        raise ValueError(f"--{name}: expected a number above {low}{limit}, got {value}")


def check_folder(option: str, folder: Path) -> None:
    """Raise OSError unless the folder of an option can be written, or made. An error later leaves no empty folder."""
    place = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not place.is_dir() or not os.access(place, os.W_OK):
        reason = os.strerror(errno.EACCES if place.is_dir() else errno.ENOTDIR)
        raise OSError(f"{option}: expected a folder that can be written, got {folder} ({reason})")


def check_earlier(folder: Path, resume: bool, force: bool, results: Iterable[Path] = ()) -> None:
    """Raise FileExistsError if a run would replace the results of an earlier one, which it neither resumes nor may.

    An earlier run left a checkpoint, a report, or one of ``results``.
    """
    has_checkpoint = (folder / CHECKPOINT).is_file()
    found = has_checkpoint or any(path.is_file() for path in (folder / REPORT, *results))
    if force or (resume and has_checkpoint) or not found:
        return
    continues = "--resume continues it, " if has_checkpoint else ""
    raise FileExistsError(
        f"--output: expected a folder without results, got {folder}, which has those of an earlier run; {continues}"
        "--force replaces it, another folder keeps it"
    )


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Raise ValueError if an output file is an input, or is named by one, such as a texture; None is skipped."""
    given = [path for path in inputs if path is not None and path.is_file()]
    read = {(status.st_dev, status.st_ino) for status in map(Path.stat, given)}
    for output in filter(Path.exists, outputs):
        status = output.stat()
        if (status.st_dev, status.st_ino) in read:
            raise ValueError(f"--output: expected a file that may be replaced, got {output}, which is an input")
        for path in given:
            if names_file(path, output):
                raise ValueError(f"--output: expected a file that may be replaced, got {output}, which {path} uses")


def picture_files(given: Iterable[Path]) -> list[Path]:
    """List pictures: the given files, and those in the given folders, by their names."""
    from .masks.rule import PICTURE_SUFFIXES

    files: list[Path] = []
    for path in given:
        inside = sorted(f for f in path.iterdir() if f.suffix.lower() in PICTURE_SUFFIXES) if path.is_dir() else [path]
        if not inside:
            raise FileNotFoundError(f"{path}: expected pictures ({', '.join(PICTURE_SUFFIXES)}), got a folder without")
        files += inside
    if not files:
        raise ValueError("images: expected at least one picture, got none")
    return files


def load_network(source: str | Path, option: str) -> FeatureNetwork:
    """Load a feature network; if a published one cannot be downloaded, name the option that takes a file."""
    try:
        return load_features(source)
    except ConnectionError as error:
        raise ConnectionError(f"{error} with {option}") from None


def say(text: str, color: str | None = None, markup: bool = False) -> None:
    """Print a line: to standard output, or in a colour, for warnings and errors, to standard error."""
    console = Console(stderr=color is not None)
    console.print(text, style=color, markup=markup, highlight=False, soft_wrap=True)


def say_finished(seconds: float, folder: Path, interrupted_after: int | None) -> None:
    """Print the time of a run, the number of steps if it was interrupted, and the folder of the results."""
    interruption = "" if interrupted_after is None else f", interrupted after {interrupted_after} steps"
    resume = "" if interrupted_after is None else " (--resume continues)"
    say(f"{seconds:.1f} s{interruption}{resume}; the results are in {folder}")


@contextmanager
def interruption() -> Iterator[list[int]]:
    """Catch the first Ctrl-C: the number of the signal is appended to the yielded list. The second one interrupts."""
    found: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        found.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield found
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def continuing(folder: Path) -> Iterator[None]:
    """Let KeyboardInterrupt say how a run continues: with --resume if it has written a checkpoint into its folder."""

    def written() -> int | None:
        return (folder / CHECKPOINT).stat().st_mtime_ns if (folder / CHECKPOINT).is_file() else None

    before = written()
    try:
        yield
    except KeyboardInterrupt:
        way = "the same command" if written() == before else "--resume"
        raise KeyboardInterrupt(f"{way} continues") from None


class Report(Protocol):
    """Receives the name of a phase, the steps done, and all steps, and a note that takes the place of their numbers."""

    def __call__(self, phase: str, done: int, total: int, note: str = "") -> None: ...


@contextmanager
def progress_bars() -> Iterator[Report]:
    """Show bars of progress, one for each phase; where the output is no terminal, lines as the work goes on."""
    console = Console()
    columns = TextColumn("{task.description:<11}"), BarColumn(), TextColumn("{task.fields[note]}")
    times = TimeElapsedColumn(), TimeRemainingColumn()
    with Progress(*columns, *times, console=console, disable=not console.is_terminal) as progress:
        bars: dict[str, TaskID] = {}
        starts: dict[str, float] = {}
        lines: dict[str, int] = {}

        def report(phase: str, done: int, total: int, note: str = "") -> None:
            if phase not in bars:
                starts[phase] = time.monotonic()
                bars[phase] = progress.add_task(phase, total=total, completed=max(0, done - 1), note="")
            progress.update(bars[phase], completed=done, total=total, note=note or f"{done}/{total}")
            part = _LINES * done // max(1, total)
            if progress.disable and lines.get(phase) != part:
                lines[phase] = part
                seconds = time.monotonic() - starts[phase]
                text = f"{phase:<11} {done}/{total}  {seconds:.0f} s  {note}".rstrip()
                console.print(text, highlight=False, markup=False, soft_wrap=True)

        yield report
