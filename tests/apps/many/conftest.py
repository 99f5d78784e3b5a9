"""Processes that begin at once: copies of one that has imported what all of them need."""

from __future__ import annotations

import multiprocessing

import pytest


@pytest.fixture
def copied_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start workers as copies of a process with torch, where the system can; a new process takes seconds to import it.

    This is for tests of what workers do. `test_results_warnings_and_failures` starts new processes, as users do.
    """
    if "forkserver" in multiprocessing.get_all_start_methods():
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["neural_renderer.apps.many.workers", "pytest"])
        monkeypatch.setattr("neural_renderer.apps.many.workers.multiprocessing.get_context", lambda _: context)
