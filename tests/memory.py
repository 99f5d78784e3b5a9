"""How much memory something takes at most, where the system tells."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@contextmanager
def takes_at_most(megabytes: float) -> Iterator[None]:
    """Assert that the block takes at most so much resident memory more than there was; skip where nobody knows."""
    try:
        _RESET.write_text("5")  # the peak begins anew
    except OSError:
        pytest.skip("the system does not tell the memory of processes")
    before = _value("VmRSS")
    yield
    grown = (_value("VmHWM") - before) / 1024
    assert grown <= megabytes, f"{grown:.0f} MB"


def _value(name: str) -> int:
    return next(int(line.split()[1]) for line in _STATUS.read_text().splitlines() if line.startswith(name))
