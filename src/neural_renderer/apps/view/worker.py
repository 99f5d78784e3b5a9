"""`Worker`: one thread that does the newest job of each kind for the viewer, in a small share of the time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from ...io.files import reason, warn

_SLOWEST = 10.0  # most seconds between two rounds


class Worker:
    """A thread that does jobs. A job replaces one of the same name that has not begun: only the newest counts.

    After each round of jobs the thread rests, so that there are at most ``rate`` rounds a second, and so that it takes
    at most ``share`` of one core, in (0, 1].
    """

    def __init__(self, rate: float, share: float = 1.0) -> None:
        self._rate, self._share = rate, share
        self._jobs: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self._closed = self._busy = self._failed = False
        self._waiting = 0  # threads in `wait`
        self._thread = threading.Thread(target=self._work, name="neural-renderer viewer", daemon=True)
        self._thread.start()

    def set_share(self, share: float) -> None:
        """Change the share of one core, also during a rest."""
        with self._changed:
            self._share = share
            self._changed.notify_all()

    def post(self, name: str, job: Callable[[], None]) -> None:
        """Do a job soon."""
        with self._changed:
            if not self._closed:
                self._jobs.pop(name, None)  # jobs that were posted meanwhile come first
                self._jobs[name] = job
                self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until nothing is left to do, without rests; return False if that takes longer."""
        with self._changed:
            self._waiting += 1
            self._changed.notify_all()
            try:
                return self._changed.wait_for(lambda: not self._jobs and not self._busy, seconds)
            finally:
                self._waiting -= 1

    def close(self) -> None:
        """Finish the round that has begun, and end."""
        with self._changed:
            self._closed = True
            self._jobs.clear()
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                jobs, self._jobs, self._busy = self._jobs, {}, True
            start, started = time.monotonic(), time.thread_time()
            for job in jobs.values():
                self._try(job)
            self._rest(start, time.thread_time() - started)

    def _rest(self, start: float, took: float) -> None:
        """Wait, after a round that began at ``start`` and took so many seconds of a core."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            while not (self._closed or self._waiting):
                left = start + max(1 / self._rate, min(took / self._share, _SLOWEST)) - time.monotonic()
                if left <= 0:
                    return
                self._changed.wait(left)

    def _try(self, job: Callable[[], None]) -> None:
        """Do a job. An error in the viewer is reported once, and does not end the task."""
        try:
            job()
        except Exception as error:
            if not self._failed:
                self._failed = True
                warn(f"the viewer failed to show something ({type(error).__name__}: {reason(error)}); the work goes on")
