"""`TaskRunner`: progress bars, previews, checkpoints and interruption of a task with many steps."""

from __future__ import annotations

import io
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import torch

from ...io.atomic_write import write_file
from ...version import __version__
from .checks import CHECKPOINT
from .command import interruption, progress_bars, say
from .observer import Knob, Observer, goes_on
from .saved_tensors import load_tensors, why_not_loaded

# Without a number of steps: least seconds between two previews and checkpoints, and the fraction of the time that they
# may take.
_SECONDS, _SHARE = 4.0, 0.02


class Task(Protocol):
    """Task of many steps, in one or several phases; ``step`` of ``steps`` are those taken in the current phase."""

    @property
    def phase(self) -> str: ...
    @property
    def step(self) -> int: ...
    @property
    def steps(self) -> int: ...
    @property
    def done(self) -> bool: ...
    def advance(self) -> dict[str, float]: ...
    def knobs(self) -> list[Knob]: ...
    def adjust(self, name: str, value: float | str, /) -> None: ...
    def state_dict(self) -> dict[str, Any]: ...
    def load_state_dict(self, state: dict[str, Any], /) -> None: ...


class TaskRunner:
    """Runs a task with progress bars, previews and checkpoints, until it is done or interrupted.

    ``settings`` identify the task: a checkpoint is accepted only if its own are equal. ``preview`` writes a picture to
    a path, after ``every`` steps, or every few seconds. The observer sees the steps, may pause and stop the task, and
    change its settings; ``mesh`` makes the current mesh for it, or several by name.
    """

    def __init__(
        self,
        folder: Path,
        task: Task,
        settings: dict[str, Any],
        preview: Callable[[Path], None],
        every: int | None = None,
        device: torch.device | str = "cpu",
        observer: Observer | None = None,
        mesh: Callable[[], Any] = dict,
    ) -> None:
        self._folder, self._task, self._settings, self._preview, self._every = folder, task, settings, preview, every
        self._checkpoint, self._device = folder / CHECKPOINT, device
        self._observer, self._mesh = observer, mesh
        self.history: list[dict[str, Any]] = []  # numbers of each step (the result of ``advance``), with its "phase"
        self.changes: list[dict[str, Any]] = []  # changes by the observer: "phase", "step" and the new value by name
        self.seconds = 0.0  # time of all steps, including those before an interruption
        self.stopped = False  # the observer has ended the task

    def run(self, resume: bool) -> bool:
        """Take all remaining steps, from the checkpoint if ``resume``; return False if Ctrl-C or the observer ended it.

        ValueError: The checkpoint is unreadable, or belongs to a task with other settings or of another version.
        """
        if resume and self._checkpoint.is_file():
            self._restore()
        task, start = self._task, time.monotonic() - self.seconds
        following = self.seconds + _SECONDS
        with progress_bars() as report, interruption() as interrupted:
            self._offer()
            while not task.done and not interrupted and goes_on(self._observer, interrupted):
                phase = task.phase
                row = task.advance()
                self.history.append({"phase": task.phase, **{name: round(value, 6) for name, value in row.items()}})
                text = "  ".join(f"{name} {value:.4f}" for name, value in list(row.items())[:2])
                report(task.phase, task.step, task.steps, text)
                self._observe(row, task.phase != phase)
                self.seconds = time.monotonic() - start
                if self.seconds > following if self._every is None else task.step % self._every == 0:
                    self._save()
                    following = time.monotonic() - start
                    following += max(_SECONDS, (following - self.seconds) / _SHARE)
            self._save()
            self.stopped = not task.done and not interrupted
        return not interrupted and not self.stopped

    def _offer(self) -> None:
        if self._observer is not None:
            self._observer.offer(self._task.knobs())

    def _observe(self, row: dict[str, float], is_new_phase: bool) -> None:
        """Show a step to the observer, and apply its changes of settings."""
        task, observer = self._task, self._observer
        if observer is None:
            return
        observer.observe(task.phase, task.step, task.steps, row, self._mesh)
        if is_new_phase:
            self._offer()
        for name, value in observer.changes().items():
            try:
                task.adjust(name, value)
                self.changes.append({"phase": task.phase, "step": task.step, name: value})
            except (TypeError, ValueError) as error:
                say(str(error), "yellow")

    def _save(self) -> None:
        self._preview(self._folder / "preview.png")
        state = {"task": self._task.state_dict(), "history": self.history, "seconds": self.seconds}
        file = io.BytesIO()  # torch.save to a path does not report why it cannot write
        torch.save({**state, "inputs": self._settings}, file)
        write_file(self._checkpoint, file.getbuffer())

    def _restore(self) -> None:
        """Resume from the checkpoint; raise ValueError if it is unreadable or its settings differ."""
        try:
            state = load_tensors(self._checkpoint, self._device)
            settings, task = state["inputs"], state["task"]
            self.history, self.seconds = state["history"], state["seconds"]
        except Exception as error:  # torch raises errors of many classes for files that are not checkpoints
            raise ValueError(
                f"{self._checkpoint}: expected a checkpoint, got another file ({why_not_loaded(error)})"
            ) from None
        # Settings absent from older checkpoints compare as None.
        ours, found = _flat(self._settings), _flat(settings)
        names = [name for name in (ours | found) if ours.get(name) != found.get(name)]
        if names:
            mine, theirs = (", ".join(f"{name} {each.get(name)}" for name in names) for each in (ours, found))
            raise ValueError(f"{self._checkpoint}: expected a checkpoint of this run ({mine}), got one of {theirs}")
        try:
            self._task.load_state_dict(task)
        except KeyError as error:
            raise ValueError(
                f"{self._checkpoint}: expected a checkpoint of version {__version__}, got one of another version (it "
                f"has no {error}); start anew"
            ) from None


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """Name the settings of groups one by one, as options do: weights.laplacian."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        flat |= {f"{name}.{key}": each for key, each in value.items()} if isinstance(value, dict) else {name: value}
    return flat


def setting_value(value: Any) -> Any:
    """Convert a setting for a checkpoint. A path becomes name and checksum of the file, so that the file may move."""
    return f"{value.name} #{zlib.crc32(value.read_bytes()):08x}" if isinstance(value, Path) else value
