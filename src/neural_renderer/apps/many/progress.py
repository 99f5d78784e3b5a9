"""Progress of a large job on the terminal: models and views per second, time left, and failures, by worker."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from ..common.command import say
from .engines import Done


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

    def __call__(self, worker: str, done: Done) -> None:
        """Add the statistics of a worker."""
        with self._lock:
            for text in done.notes:
                self._console.print(text, style="yellow", markup=False, soft_wrap=True, highlight=False)
            for text in done.problems:
                self._console.print(text, style="red", markup=False, soft_wrap=True, highlight=False)
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
