"""`Newest`: the latest copy of each mesh that a program shows, made in a small fraction of the program's time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from ...io.files import reason, warn
from .drawing.snapshot import Snapshot, check_mesh, take_snapshot

_SHARE = 0.01  # share of the task's thread that copies of meshes may take
_IDLE = 1.0  # seconds between two copies while no browser or record wants them


class Newest:
    """Copies of meshes, by name. Threads may share it.

    Copies are made at most ``rate`` times a second, and take at most 1 % of the time. ``put`` takes the name of a mesh
    and its new copy. Unless ``is_watched`` returns True, for a browser or a record, one copy per second is made.
    ``postpone`` is called when a mesh came too early; `catch_up` is to be called soon.
    """

    def __init__(
        self,
        rate: float,
        put: Callable[[str, Snapshot], None],
        is_watched: Callable[[], bool],
        postpone: Callable[[], None],
    ) -> None:
        self._rate, self._put, self._is_watched, self._postpone = rate, put, is_watched, postpone
        self._lock = threading.RLock()
        self._copying = threading.RLock()  # one copy at a time: an older one never replaces a newer one
        self._copies: dict[str, Snapshot] = {}
        self._early: dict[str, Any] = {}
        self._next = 0.0  # time of the next copy
        self._left_out: tuple[tuple[int, str], Callable[[], Mapping[str, Any]]] | None = None
        self.frame = (0, "")  # number and label of the newest step
        self.is_hurried = False  # copies may take all the time, because the work is over

    def __contains__(self, name: str) -> bool:
        return name in self._copies

    def show(self, mesh: Any, name: str) -> None:
        """Copy a mesh as a separate step, now or, if the last copy is too recent, in `catch_up`."""
        check_mesh(mesh)
        with self._lock:
            self.frame = self.frame[0] + 1, ""
            if name in self._copies and time.monotonic() < self._next:
                self._early[name] = mesh
                self._postpone()
                return
        self._copy(lambda: {name: mesh})

    def observe(self, frame: tuple[int, str], meshes: Callable[[], Mapping[str, Any]], always: bool) -> None:
        """Make and copy the meshes of a step, if it is time, or ``always``."""
        if not always and time.monotonic() < self._next:
            self._left_out = frame, meshes
            return
        self._left_out = None
        with self._lock:
            self.frame = frame
        self._copy(meshes)

    def finish(self) -> None:
        """Copy the postponed meshes and the last step at the end of the work. Call it in the work's thread."""
        self.is_hurried = True
        if self._left_out is not None:
            self.observe(*self._left_out, always=True)
        self.catch_up()

    def catch_up(self) -> None:
        """Copy the postponed meshes. A warning names a mesh whose faces do not fit its vertices."""
        with self._copying:
            with self._lock:
                early, self._early = self._early, {}
            for name, mesh in early.items():
                try:
                    copy = take_snapshot(mesh)
                except (TypeError, ValueError) as error:  # `show` has returned: nobody would catch it here
                    warn(f"the viewer leaves out {name}: {reason(error)}")
                else:
                    self._keep(name, copy)

    def remove(self, name: str) -> None:
        """Forget a mesh; raise ValueError if there is none of this name."""
        with self._lock:
            if name not in self._copies:
                raise ValueError(f"name: expected one of {', '.join(self._copies) or 'none'}, got {name!r}")
            del self._copies[name]
            self._early.pop(name, None)

    def all(self) -> tuple[tuple[int, str], dict[str, Snapshot]]:
        """Return the newest step, and the copies by name."""
        with self._lock:
            return self.frame, dict(self._copies)

    def _copy(self, meshes: Callable[[], Mapping[str, Any]]) -> None:
        start = time.perf_counter()
        with self._copying:
            for name, mesh in meshes().items():
                with self._lock:
                    self._early.pop(name, None)
                self._keep(name, take_snapshot(mesh))
        took = time.perf_counter() - start
        pause = 1 / self._rate if self.is_hurried else max(1 / self._rate, took / _SHARE)
        if not self.is_hurried and not self._is_watched():
            pause = max(pause, _IDLE)
        self._next = time.monotonic() + pause

    def _keep(self, name: str, copy: Snapshot) -> None:
        with self._lock:
            self._copies[name] = copy
        self._put(name, copy)
