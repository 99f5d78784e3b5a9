"""Progress of a large job on the terminal: models and views per second, time left, and failures, by worker."""

from __future__ import annotations

import re
import threading
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from ...base.requirements import printable
from ..common.command import say
from .engines import Done

_FEW, _KINDS = 3, 20  # printed messages of each kind, and printed kinds; a list may have a million bad models
_VARYING = re.compile(r"'[^']*'|\"[^\"]*\"|\d+")  # in messages of one kind


class Watching:
    """Progress bar of a job on ``total`` models, as a context manager. Calling it adds the statistics of a worker.

    ``workers`` has the statistics of each worker, ``total`` their sum, both without the entry "before".
    """

    def __init__(self, total: int, what: str = "models") -> None:
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}")
        self._console = Console(stderr=True)
        self._progress = Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=self._console)
        self._task = self._progress.add_task(what, total=total, note="")
        self._what, self._lock = what, threading.Lock()
        self._before = 0
        self._told: dict[str, tuple[int, str]] = {}  # number of messages, and the first, of each kind
        self.workers: dict[str, Done] = {}
        self.total = Done()

    def __enter__(self) -> Watching:
        self._start = time.monotonic()
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.seconds = time.monotonic() - self._start
        self._progress.stop()
        for count, first in self._told.values():
            if count > _FEW:
                say(f"{count - _FEW:,} more messages like: {first}", "yellow")

    def __call__(self, worker: str, done: Done) -> None:
        """Add the statistics of a worker."""
        with self._lock:
            for text in done.notes:
                self._tell(text, "yellow")
            for text in done.problems:
                self._tell(text, "red")
            if worker == "before":
                self._before += done.models
                self._progress.reset(self._task, completed=self._before)
                return
            self.workers.setdefault(worker, Done()).add(done)
            self.total.add(done)
            rate = 1 / max(time.monotonic() - self._start, 1e-9)
            note = f"{self.total.models * rate:.2f} {self._what}/s"
            note += f"  {self.total.views * rate:.1f} views/s" if self.total.views else ""
            note += f"  {self.total.failures} failed" if self.total.failures else ""
            self._progress.update(self._task, advance=done.models, note=note)

    def _tell(self, text: str, color: str) -> None:
        """Print a message if few of its kind came before."""
        begin = text.find("expected")
        kind = _VARYING.sub("", text[begin:] if begin >= 0 else text.rpartition(": ")[2])
        kind = kind if kind in self._told or len(self._told) < _KINDS else "others"
        count, first = self._told.get(kind, (0, text))
        self._told[kind] = count + 1, first
        if count < _FEW:
            self._console.print(printable(text), style=color, markup=False, soft_wrap=True, highlight=False)

    def say_rates(self) -> None:
        """Print the statistics of the workers, and the processor time by part of the work."""
        if self.total.models:
            Console().print(self._table())
            if costs := self._costs():
                say(costs)

    def _table(self) -> Table:
        table = Table("worker", self._what, "views", "failed", f"{self._what}/s")
        for name in sorted(self.workers):
            done = self.workers[name]
            rate = done.models / max(self.seconds, 1e-9)
            table.add_row(name, str(done.models), str(done.views), str(done.failures), f"{rate:.2f}")
        return table

    def _costs(self) -> str:
        """Describe the processor time of a view, and the share of each part of the work; "" if it is unknown."""
        parts, whole = self.total.seconds, sum(self.total.seconds.values())
        if not whole or not self.total.views:
            return ""
        shares = ", ".join(f"{part} {seconds / whole:.0%}" for part, seconds in parts.items())
        return f"{1000 * whole / self.total.views:.1f} ms of processor time a view: {shares}"
