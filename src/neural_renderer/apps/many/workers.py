"""`Worker`: a process that does jobs one by one, within limits of time and memory.

A job that crashes, hangs or takes too much memory costs its process, and nothing else: the next job gets another one.
Temporary files of a process are in a folder of its own, which the parent removes however the process ends.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from ...io.atomic_write import make_staging, sweep

_LOOK = 0.05  # seconds between two looks at the memory of a process
_GRACE = 60  # seconds after the time limit at which a process ends itself, if nobody has ended it
_TRIES = 3  # of a job whose process dies: others may have killed it
_RECYCLED = 0.5  # share of the memory limit above which an idle process is replaced
_FAILED = "failed"
Work = Callable[[Any], Any]
"""Function of a job. It can be pickled, and so can jobs and results."""


@dataclass(frozen=True)
class Limits:
    """Limits of a job; None for no limit."""

    seconds: float | None = None
    memory: int | None = None  # bytes of memory of its process; measured on Linux only


class JobError(Exception):
    """Failure of one job; its message is the reason."""


class _TimeLimit(Exception):
    """The time is over."""


class _MemoryLimit(Exception):
    """A process takes too much memory."""


class Stopped(Exception):
    """The worker was asked to stop."""


class Worker:
    """Runs jobs in a separate process, which starts on demand and is replaced when it dies.

    The limits hold for each job; when ``stop`` is set, the job ends immediately with `Stopped`.
    """

    def __init__(self, limits: Limits = Limits(), stop: threading.Event | None = None) -> None:
        self.limits, self._stop = limits, stop or threading.Event()
        self._process: Any = None
        self._folder: Path | None = None  # for temporary files of the process
        self._jobs = 0  # done by the present process
        self._number = 0  # of the present job

    def run(self, work: Work, job: Any) -> tuple[Any, list[str]]:
        """Compute ``work(job)``: return the result and the warnings.

        A crash is blamed on the job only after retries in fresh processes, up to three times; excessive memory only
        after a retry in a fresh process. JobError: The work raised an exception, its process died, or a limit was
        exceeded.
        """
        for attempt in range(1, _TRIES + 1):
            is_new = self._start()
            self._number += 1
            try:
                self._pipe.send((self._number, work, job, self.limits.seconds))
                kind, value, notes = self._answer()
            except (EOFError, OSError):  # the pipe is closed or broken
                death = self._end()
                if attempt == _TRIES:
                    raise JobError(f"expected a result, got a process that died ({death})") from None
            except _MemoryLimit:
                self._end()
                if is_new:
                    most = (self.limits.memory or 0) / 2**30
                    raise JobError(f"expected to need at most {most:g} GiB of memory, got more") from None
            except _TimeLimit:
                self._end()
                raise JobError(f"expected an end within {self.limits.seconds:g} s, got none") from None
            except BaseException:  # `Stopped`, or Ctrl-C
                self._end()
                raise
            else:
                self._jobs += 1
                if self._memory() > _RECYCLED * (self.limits.memory or float("inf")):
                    self.close()
                if kind == _FAILED:
                    raise JobError(value)
                return value, notes
        raise JobError("expected a result, got none")  # pragma: no cover

    def close(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            self._end()

    def _start(self) -> bool:
        """Start a process if there is none; return whether it is fresh."""
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, other = context.Pipe()
            self._folder = _temporary_folder()
            self._process = context.Process(target=_serve, args=(other, self._folder), daemon=True)
            self._process.start()
            other.close()
            self._jobs = 0
        return self._jobs == 0

    def _answer(self) -> tuple[str, Any, list[str]]:
        """Wait for the answer of the process and check its memory; raises exceptions that `run` converts."""
        deadline = None
        while True:
            if self._stop.is_set():
                raise Stopped
            if wait([self._pipe], _LOOK):
                number, answer = self._pipe.recv()
                if number != self._number:  # a copy of the process, which an earlier job has made
                    continue
                if answer is not None:
                    return answer
                if self.limits.seconds is not None:  # the process has begun with the job
                    deadline = time.monotonic() + self.limits.seconds
            elif deadline is not None and time.monotonic() > deadline:
                raise _TimeLimit
            if self.limits.memory is not None and self._memory() > self.limits.memory:
                raise _MemoryLimit

    def _memory(self) -> int:
        """Return the bytes of memory of the process; 0 on systems without this information."""
        try:
            pages = Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]
            return int(pages) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, ValueError, IndexError, AttributeError):
            return 0

    def _end(self) -> str:
        """Kill the process and forget it; say how it had ended."""
        process, self._process = self._process, None
        with suppress(OSError):
            self._pipe.close()
        process.join(_LOOK)
        status = process.exitcode
        process.kill()
        process.join()
        process.close()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        if status is not None and status < 0:
            with suppress(ValueError):
                return signal.Signals(-status).name
        return f"exit status {status}"


class WorkerHere(Worker):
    """Does jobs in this process, without limits."""

    def run(self, work: Work, job: Any) -> tuple[Any, list[str]]:
        """Compute ``work(job)``; see `Worker.run`."""
        kind, value, notes = _performed(work, job)
        if kind == _FAILED:
            raise JobError(value)
        return value, notes


def _performed(work: Work, job: Any) -> tuple[str, Any, list[str]]:
    """Do a job: return "done" with the result, or "failed" with the reason; and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            value = work(job)
        except Exception as error:  # one job must not stop the others
            expected = isinstance(error, (ValueError, OSError)) and str(error)
            text = str(error) if expected else f"{type(error).__name__}: {error}"
            return _FAILED, " ".join(text.encode(errors="backslashreplace").decode().split()), []
    return "done", value, sorted({str(warning.message) for warning in caught if warning.category is UserWarning})


def _temporary_folder() -> Path | None:
    """Make a folder for the temporary files of a process, and remove those of killed ones; None if none can be made."""
    try:
        place = Path(tempfile.gettempdir())
        sweep(place)
        return make_staging(place)
    except OSError:
        return None


def _serve(pipe: Connection, folder: Path | None) -> None:
    """Do jobs from a pipe until it closes: the main function of a process, with a folder for its temporary files."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is left to the parent
    os.environ["OMP_NUM_THREADS"] = "1"  # for torch, which the first job imports, if nobody has done so
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    if folder is not None:
        tempfile.tempdir = str(folder)
        os.environ |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))  # for programs that it starts
    parent, process = multiprocessing.parent_process(), os.getpid()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            number, work, job, seconds = pipe.recv()
            pipe.send((number, None))
            if seconds is not None and hasattr(signal, "setitimer"):
                # A signal ends a process even if it holds Python's lock and its parent was killed.
                signal.setitimer(signal.ITIMER_REAL, seconds + _GRACE)
            answer = _performed(work, job)
            if os.getpid() != process:  # a copy of the process, which the job has made
                os._exit(0)
            if hasattr(signal, "setitimer"):
                signal.setitimer(signal.ITIMER_REAL, 0)
            pipe.send((number, answer))
