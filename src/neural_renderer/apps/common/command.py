"""Devices, messages and progress of the commands."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Protocol

import torch

from .checks import CHECKPOINT
from .terminal import INTERRUPTED as INTERRUPTED
from .terminal import say as say

if TYPE_CHECKING:
    from .features import FeatureNetwork

_LINES = 4  # progress lines per phase after the first, where the output is no terminal
MISMATCH = 3
"""Exit code of a command whose result is doubtful: it does not agree with the pictures, or they say too little."""


def choose_device(name: str) -> torch.device:
    """Choose a device by the name "cpu", "cuda" or "auto". Raises ValueError if CUDA is requested and missing."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device: expected cpu, got cuda, but torch finds no CUDA device here")
    return torch.device(name)


def load_network(source: str | Path, option: str) -> FeatureNetwork:
    """Load a feature network; if a published one cannot be downloaded, name the option that takes a file."""
    from .features import load_features  # for few commands

    try:
        return load_features(source)
    except ConnectionError as error:
        raise ConnectionError(f"{error} with {option}") from None


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
    """Add advice to KeyboardInterrupt: --resume if the run has written a checkpoint, else the same command."""

    def written() -> int | None:
        return (folder / CHECKPOINT).stat().st_mtime_ns if (folder / CHECKPOINT).is_file() else None

    before = written()
    try:
        yield
    except KeyboardInterrupt:
        continuation = "the same command" if written() == before else "--resume"
        raise KeyboardInterrupt(f"{continuation} continues") from None


class Report(Protocol):
    """Callback for progress: name of the phase, steps done, number of steps, and a note to show in their place."""

    def __call__(self, phase: str, done: int, total: int, note: str = "") -> None: ...


@contextmanager
def progress_bars() -> Iterator[Report]:
    """Show a progress bar for each phase, or print lines if the output is not a terminal."""
    from rich.console import Console  # takes time, which commands without bars save
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

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
