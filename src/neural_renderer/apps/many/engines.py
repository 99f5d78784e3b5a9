"""Engines run the parts of a large job: in processes of this machine, or as tasks of Ray on a cluster.

A part is done by ``perform(part, worker, report)``, in one of several places at the same time. It must be repeatable:
Ray does it again when a node is lost. Results are the same with every engine.
"""

from __future__ import annotations

import os
import platform
import queue
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from ...io.files import import_library
from .options import EngineOptions
from .workers import Limits, Stopped, Worker, WorkerHere


@dataclass
class Done:
    """Statistics of finished work: counts, processor seconds by part of the work, and messages, which sums drop."""

    models: int = 0
    views: int = 0
    failures: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    problems: tuple[str, ...] = ()  # failures in words
    notes: tuple[str, ...] = ()  # warnings in words

    def add(self, other: Done) -> None:
        """Add the numbers of another."""
        self.models, self.views = self.models + other.models, self.views + other.views
        self.failures += other.failures
        for part, seconds in other.seconds.items():
            self.seconds[part] = self.seconds.get(part, 0.0) + seconds


Report = Callable[[Done], None]
"""Callback with the statistics since its last call."""

Part = TypeVar("Part")
Result = TypeVar("Result")
Perform = Callable[[Part, Worker, Report], Result]
Watch = Callable[[str, Done], None]
"""Callback with the name of a worker and its statistics since its last call."""
_ROOM = 2  # tasks of Ray for each processor that are waiting or running
_LOOK = 0.5  # seconds


class Engine(Protocol):
    """Runs parts, and yields each with its result when it is finished.

    When the generator is closed, or Ctrl-C interrupts it, work ends within seconds; parts that are not done are lost.
    """

    def run(
        self, perform: Perform[Part, Result], parts: Sequence[Part], watch: Watch
    ) -> Generator[tuple[Part, Result], None, None]:
        """Do the parts; an exception of ``perform`` ends all and is raised here."""
        ...


@dataclass(frozen=True)
class Local:
    """Processes of this machine, each with one thread."""

    processes: int  # their number; 0 for none: this process does the work, without limits
    limits: Limits = Limits()  # noqa: RUF009 (immutable)

    def run(
        self, perform: Perform[Part, Result], parts: Sequence[Part], watch: Watch
    ) -> Generator[tuple[Part, Result], None, None]:
        """See `Engine.run`."""
        if self.processes == 0:
            for part in parts:
                yield part, perform(part, WorkerHere(), lambda done: watch("here", done))
            return
        waiting: queue.SimpleQueue[Part] = queue.SimpleQueue()
        for part in parts:
            waiting.put(part)
        finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        stop = threading.Event()

        def supervise(name: str) -> None:
            with closing(Worker(self.limits, stop)) as worker, suppress(Stopped):
                while not stop.is_set():
                    try:
                        part = waiting.get_nowait()
                    except queue.Empty:
                        return
                    try:
                        finished.put((part, perform(part, worker, lambda done: watch(name, done)), None))
                    except Stopped:
                        raise
                    except BaseException as error:
                        finished.put((part, None, error))
                        return

        count = min(self.processes, len(parts))
        threads = [threading.Thread(target=supervise, args=(f"process {n + 1}",)) for n in range(count)]
        for thread in threads:
            thread.start()
        try:
            for _ in parts:
                part, result, error = _next(finished)
                if error is not None:
                    raise error
                yield part, result
        finally:
            stop.set()
            for thread in threads:
                thread.join()


def _next(finished: queue.SimpleQueue[Any]) -> Any:
    """Wait for a result; Ctrl-C interrupts it on every system."""
    while True:
        with suppress(queue.Empty):
            return finished.get(timeout=_LOOK)


@dataclass(frozen=True)
class OnRay:
    """Tasks of Ray, one processor each, on the nodes of a cluster.

    Tasks, not actors: waiting tasks occupy no processor, so that two of them do not block each other on a machine with
    two processors, and Ray repeats tasks whose worker or node is lost.
    """

    address: str | None = (
        None  # address of a cluster, such as "auto" on one of its nodes; None starts Ray on this machine
    )
    processes: int | None = None  # processors that Ray uses on this machine, if it is started here
    limits: Limits = Limits()  # noqa: RUF009 (immutable)

    def run(
        self, perform: Perform[Part, Result], parts: Sequence[Part], watch: Watch
    ) -> Generator[tuple[Part, Result], None, None]:
        """See `Engine.run`."""
        ray = import_library("ray", "for the engine ray")
        started = not ray.is_initialized()
        if started:
            here = {} if self.address else {"num_cpus": self.processes}
            ray.init(self.address or "local", logging_level="ERROR", log_to_driver=False, **here)
        task = ray.remote(num_cpus=1, max_retries=-1)(_perform_on_ray)
        shared = ray.put((perform, self.limits))
        waiting = list(reversed(parts))
        running: dict[Any, Part] = {}
        try:
            while waiting or running:
                most = max(2, int(_ROOM * ray.cluster_resources().get("CPU", 1)))
                while waiting and len(running) < most:
                    part = waiting.pop()
                    name = f"part {getattr(part, 'name', '')}".strip()
                    running[task.options(name=name).remote(shared, part)] = part
                for done in ray.wait(list(running), timeout=_LOOK)[0]:
                    part = running.pop(done)
                    try:
                        worker, work, result = ray.get(done)
                    except ray.exceptions.RayTaskError as error:
                        raise (error.cause or error) from None
                    watch(worker, work)
                    yield part, result
        finally:
            for done in running:
                with suppress(Exception):
                    ray.cancel(done, force=True)
            if started:
                ray.shutdown()


def choose_engine(options: EngineOptions) -> Engine:
    """Make the engine of validated options."""
    if options.engine == "ray":
        return OnRay(options.address, max(1, options.processes), limits_of(options))
    return Local(options.processes, limits_of(options))


def limits_of(options: EngineOptions) -> Limits:
    """Return the limits of a model or run."""
    return Limits(options.time_limit or None, int(options.memory_limit * 2**30) or None)


_worker: Worker | None = None  # one for all tasks in this process of Ray


def _perform_on_ray(shared: tuple[Perform[Any, Any], Limits], part: Any) -> tuple[str, Done, Any]:
    """Do a part in a process of Ray; return its name, what was done, and the result."""
    global _worker
    from ray.util import metrics

    perform, limits = shared
    if _worker is None or _worker.limits != limits:
        _worker = Worker(limits)
    models, views, failures = (
        metrics.Counter(f"neural_renderer_{name}", f"{name.capitalize()} done")
        for name in ("models", "views", "failures")
    )
    total = Done()
    problems: list[str] = []

    def report(done: Done) -> None:
        total.add(done)
        problems.extend(done.problems)
        for counter, number in ((models, done.models), (views, done.views), (failures, done.failures)):
            if number:
                counter.inc(number)

    result = perform(part, _worker, report)
    total.problems = tuple(problems)
    return f"{platform.node()} {os.getpid()}", total, result
