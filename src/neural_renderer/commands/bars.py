"""Progress of work in phases, as bars on a terminal and as lines in a file."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_LINES = 4  # lines of a phase in a file, beside that of its start


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
