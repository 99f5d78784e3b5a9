"""Programs that tests start in separate processes, and files that several processes share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.paths import ROOT

_HANGING = 900  # seconds; no program needs a tenth of that on an idle machine


def search_path(*folders: Path) -> str:
    """The PYTHONPATH of this process, with ``folders`` before it."""
    return os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])


def run_python(*arguments: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run this Python with ``arguments`` and with ``variables`` in its environment; `tests` can be imported."""
    environment = os.environ | {"PYTHONPATH": search_path(ROOT)} | variables
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=_HANGING, check=False)


@contextmanager
def one_process(lock: Path) -> Iterator[None]:
    """Let other processes wait that come to the same file, so that one of them makes what all of them need."""
    import fcntl  # not on Windows

    with open(lock, "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
