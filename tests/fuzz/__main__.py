"""Run the fuzzers for some time: ``python -m tests.fuzz --seconds 600 --seed 7 [NAME …]``.

Each fuzzer has a process of its own, so that a crash ends that one only, and an equal share of the time. Inputs follow
from the seed. What fails is written to ``tests/fuzz/crashes``, where tests find it; the exit code is 1 then.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.fuzzers import CRASHES, FUZZERS, keep
from tests.fuzz.work import work

SLOW = 120.0  # seconds over its share after which a fuzzer that has begun counts as hanging
START = 600.0  # seconds until it has begun


def main() -> int:
    """Run the fuzzers that are named, or all, one after the other."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(FUZZERS)}")
    parser.add_argument("--seconds", type=float, default=600.0, help="time of all fuzzers together")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="number that all inputs follow from")
    options = parser.parse_args()
    names = options.names or list(FUZZERS)
    sys.stdout.write(f"seed {options.seed}\n")
    sys.stdout.flush()
    failed = []
    for name in names:
        share = options.seconds / len(names)
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
            place = Path(folder)
            context = multiprocessing.get_context("spawn")
            begun = context.Event()  # a busy machine takes long to import and to make good files
            process = context.Process(target=work, args=(name, options.seed, share, place, begun))
            process.start()
            begun.wait(START)
            process.join(share + SLOW)
            code = process.exitcode
            process.kill()
            process.join()
            if code not in (0, 1):  # it crashed, or hangs
                for path in (place / "present").rglob("*"):
                    if path.is_file():
                        kept = keep(name, path.relative_to(place / "present").as_posix(), path.read_bytes())
                        sys.stdout.write(f"{name}: {kept}\n")
                sys.stdout.write(f"{name}: the process {'hangs' if code is None else f'ended with {code}'}\n")
            failed += [name] if code else []
    sys.stdout.write(f"failed: {', '.join(failed)}; see {CRASHES}\n" if failed else "nothing failed\n")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
