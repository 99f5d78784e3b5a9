"""Jobs that worker processes of tests do."""

from __future__ import annotations

import os
import signal
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from neural_renderer.apps.many.engines import Done, Report
from neural_renderer.apps.many.workers import JobError, Worker


def double(number: int) -> int:
    """Warn of odd numbers, refuse negative ones."""
    if number < 0:
        raise ValueError(f"number: expected at least 0,\n got {number}")
    if number % 2:
        warnings.warn(f"{number} is odd", stacklevel=1)
    return 2 * number


def process_id(_: object) -> int:
    return os.getpid()


def sleep(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def die(marker: Path) -> str:
    """Die as if killed from outside; survive when ``marker`` has as many letters as tries before."""
    tries = len(marker.read_text()) if marker.exists() else 0
    if tries < int(marker.suffix[1:]):
        marker.write_text("x" * (tries + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def crash(_: object) -> None:
    """Die of a wrong address, as native code does."""
    os.kill(os.getpid(), signal.SIGSEGV)


def unpack_and_sleep(seconds: float) -> str:
    """Leave a temporary file, as a process does that is killed while it reads an archive."""
    with tempfile.NamedTemporaryFile(prefix="part", delete=False) as file:
        file.write(b"v 0 0 0")
    time.sleep(seconds)
    return file.name


def fork(value: str) -> str:
    """Return in two processes."""
    os.fork()
    return value


def fill(size: int) -> int:
    """Take ``size`` bytes of memory until the end of the process."""
    kept = bytearray(size)
    for place in range(0, size, 4096):
        kept[place] = 1
    time.sleep(3600)
    return len(kept)


@dataclass(frozen=True)
class Doubled:
    """Part of a work: doubles numbers, and notes those that fail."""

    def __call__(self, numbers: tuple[int, ...], worker: Worker, report: Report) -> list[int | str]:
        found: list[int | str] = []
        for number in numbers:
            if number == 1000:
                raise OSError("the disk is full")
            try:
                found.append(worker.run(double, number)[0])
                report(Done(1))
            except JobError as error:
                found.append(str(error))
                report(Done(1, failures=1, problems=(str(error),)))
        return found


@contextmanager
def watched_ray(wanted: bool) -> Iterator[None]:
    """Start Ray once for a test, without its dashboard, or skip the test; nothing if it is not ``wanted``."""
    if not wanted:
        yield
        return
    ray = pytest.importorskip("ray")
    ray.init("local", num_cpus=2, include_dashboard=False, logging_level="ERROR", log_to_driver=False)
    try:
        yield
    finally:
        ray.shutdown()
