"""Options of engines, checked, and the end of a work on many models, for people."""

from __future__ import annotations

import re

from rich.console import Console

from ...many.engines import Engine, Local, OnRay
from ...many.progress import Watching
from ...many.workers import Limits
from ..common import check_counts, say
from .options import EngineOptions


def choose_engine(options: EngineOptions) -> Engine:
    """Make the engine; raise ValueError for options that are out of range or do not fit each other."""
    check_counts(options, processes=0, time_limit=0, memory_limit=0)
    if options.address is not None and options.engine != "ray":
        raise ValueError(f"--address: expected --engine ray, got --engine {options.engine}")
    if options.engine == "ray":
        return OnRay(options.address, max(1, options.processes), limits_of(options))
    return Local(options.processes, limits_of(options))


def limits_of(options: EngineOptions) -> Limits:
    """Return the limits of a model or run."""
    return Limits(options.time_limit or None, int(options.memory_limit * 2**30) or None)


def chosen_share(options: EngineOptions) -> tuple[int, int]:
    """Return number and count of the part to do, (0, 1) for all; raise ValueError for another text than I/N."""
    if options.shard is None:
        return 0, 1
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", options.shard)
    number, count = (int(found[1]), int(found[2])) if found else (0, 0)
    if number >= count:
        raise ValueError(f"--shard: expected I/N with I from 0 to N - 1, such as 3/64, got {options.shard}")
    return number, count


def say_rates(watching: Watching) -> None:
    """Print what each worker did, and where the time went."""
    if watching.total.models:
        Console().print(watching.table())
        if costs := watching.costs():
            say(costs)
