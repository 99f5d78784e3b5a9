"""One fuzzer at work in a process of its own."""

from __future__ import annotations

import random
import sys
import time
import traceback
import warnings
from multiprocessing.synchronize import Event
from pathlib import Path

from tests.fuzz.fuzzers import FUZZERS, keep

MOST = 5  # different failures of a fuzzer that are kept


def work(name: str, seed: int, seconds: float, place: Path, begun: Event) -> None:
    """Run one fuzzer in this process; its present input lies in ``place``. Exits with 1 if something failed."""
    warnings.simplefilter("ignore")
    (place / "good").mkdir()
    fuzzer = FUZZERS[name](place / "good")
    rng = random.Random(f"{name} {seed}")
    begun.set()
    end, count, failures = time.monotonic() + seconds, 0, set()
    while time.monotonic() < end and len(failures) < MOST:
        file, data = fuzzer.draw(rng)
        present = place / "present" / file
        present.parent.mkdir(parents=True, exist_ok=True)
        present.write_bytes(data)
        try:
            fuzzer.run(file, data)
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            if (what := (type(error).__name__, last.filename, last.lineno)) not in failures:
                failures.add(what)
                sys.stdout.write(f"{name}: {keep(name, file, data)}\n{traceback.format_exc(limit=-6)}\n")
        present.unlink()
        count += 1
    fuzzer.close()
    sys.stdout.write(f"{name}: {count} inputs, {len(failures)} failures\n")
    sys.stdout.flush()
    sys.exit(bool(failures))
