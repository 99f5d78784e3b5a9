"""Worker processes: results, failures, lost processes, limits; and engines, which divide a work among them."""

from __future__ import annotations

import os
import threading
from contextlib import closing
from pathlib import Path

import pytest

from neural_renderer.apps.many.engines import Done, Engine, Local
from neural_renderer.apps.many.workers import JobError, Limits, Stopped, Worker, WorkerHere
from tests.apps.many import jobs

PARTS = [(1, 2), (3, -4), (), (6,)]
RESULTS = {(1, 2): [2, 4], (3, -4): [6, "number: expected at least 0, got -4"], (): [], (6,): [12]}


@pytest.mark.parametrize("kind", [Worker, WorkerHere])
def test_results_warnings_and_failures(kind: type[Worker]) -> None:
    with closing(kind()) as worker:
        assert worker.run(jobs.double, 2) == (4, [])
        assert worker.run(jobs.double, 3) == (6, ["3 is odd"])
        with pytest.raises(JobError, match=r"^number: expected at least 0, got -1$"):
            worker.run(jobs.double, -1)
        with pytest.raises(JobError, match=r"^TypeError: "):
            worker.run(jobs.double, None)
        here = worker.run(jobs.process_id, None)[0]
        assert worker.run(jobs.process_id, None)[0] == here  # one process does many jobs
        assert (here == os.getpid()) == (kind is WorkerHere)


@pytest.mark.slow
@pytest.mark.usefixtures("copied_processes")
@pytest.mark.skipif(os.name != "posix", reason="processes are killed by signals")
def test_a_lost_process_costs_no_job_that_it_did_not_end(tmp_path: Path) -> None:
    with closing(Worker()) as worker:
        assert worker.run(jobs.die, tmp_path / "tries.2") == ("alive", [])
        with pytest.raises(JobError, match=r"expected a result, got a process that died \(SIGKILL\)"):
            worker.run(jobs.die, tmp_path / "tries.3")
        with pytest.raises(JobError, match=r"process that died \(SIGSEGV\)"):
            worker.run(jobs.crash, None)
        assert worker.run(jobs.double, 2) == (4, [])


@pytest.mark.slow
@pytest.mark.usefixtures("copied_processes")
def test_a_job_that_hangs() -> None:
    with closing(Worker(Limits(seconds=1.0))) as worker:
        with pytest.raises(JobError, match="expected an end within 1 s, got none"):
            worker.run(jobs.sleep, 3600)
        worker.limits = Limits()
        assert worker.run(jobs.double, 2) == (4, [])


@pytest.mark.usefixtures("copied_processes")
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not tell the memory of processes")
def test_a_job_that_takes_too_much_memory() -> None:
    with closing(Worker(Limits(memory=2**29))) as worker:
        first = worker.run(jobs.process_id, None)[0]
        with pytest.raises(JobError, match=r"expected to need at most 0\.5 GiB of memory, got more"):
            worker.run(jobs.fill, 2**29)
        assert worker.run(jobs.process_id, None)[0] != first


@pytest.mark.usefixtures("copied_processes")
def test_a_worker_that_is_told_to_stop() -> None:
    stop = threading.Event()
    with closing(Worker(Limits(), stop)) as worker:
        threading.Timer(0.5, stop.set).start()
        with pytest.raises(Stopped):
            worker.run(jobs.sleep, 3600)


def check_engine(engine: Engine) -> None:
    """All parts are done, each once, with their failures; an error of a part ends the work."""
    total = Done()
    watched: list[str] = []

    def watch(worker: str, done: Done) -> None:
        total.add(done)
        watched.append(worker)

    with closing(engine.run(jobs.Doubled(), PARTS, watch)) as finished:
        assert dict(finished) == RESULTS
    assert (total.models, total.failures) == (5, 1) and watched
    with pytest.raises(OSError, match="the disk is full"), closing(engine.run(jobs.Doubled(), [(1000,)], watch)) as bad:
        list(bad)


@pytest.mark.usefixtures("copied_processes")
@pytest.mark.parametrize("processes", [0, 1, 3])
def test_local(processes: int) -> None:
    check_engine(Local(processes))


@pytest.mark.usefixtures("copied_processes")
def test_an_engine_that_is_closed_ends_its_workers() -> None:
    done: list[int] = []

    def perform(part: float, worker: Worker, report: object) -> None:
        done.append(worker.run(jobs.process_id, None)[0])
        worker.run(jobs.sleep, part)

    with closing(Local(2).run(perform, [0.0, 3600.0, 3600.0], lambda *_: None)) as finished:
        assert next(finished)[0] == 0.0
    for process in done:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)
