"""The engine that the options name, and its rates for the terminal."""

from __future__ import annotations

from rich.console import Console

from ...common.command import say
from ..engines import Engine, Local, OnRay
from ..options import EngineOptions
from ..progress import Watching
from ..workers import Limits


def choose_engine(options: EngineOptions) -> Engine:
    """Make the engine of checked options."""
    seconds, memory = options.time_limit or None, int(options.memory_limit * 2**30) or None
    if options.engine == "ray":
        return OnRay(options.address, max(1, options.processes), Limits(seconds, memory))
    return Local(options.processes, Limits(seconds, memory))


def say_rates(watching: Watching) -> None:
    """Print what each worker did, and where the time went."""
    if watching.total.models:
        Console().print(watching.table())
        if costs := watching.costs():
            say(costs)
