"""Running a task of many steps: progress, a preview, checkpoints, Ctrl-C."""

from __future__ import annotations

import io
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ..io.atomic_write import write_file
from ..io.files import load_tensors, why_not_loaded
from .common import interruption

_SECONDS = 4.0  # from one preview and checkpoint to the next


class Task(Protocol):
    """What takes steps until it is done, in one phase or several."""

    @property
    def phase(self) -> str: ...
    @property
    def step(self) -> int: ...
    @property
    def steps(self) -> int: ...
    @property
    def done(self) -> bool: ...
    def advance(self) -> dict[str, float]: ...
    def state_dict(self) -> dict[str, Any]: ...
    def load_state_dict(self, state: dict[str, Any], /) -> None: ...


class Run:
    """Steps of a task with progress, a preview and a checkpoint from time to time, until it is done or interrupted.

    Args:
        folder: where ``preview.png`` and ``checkpoint.pt`` go.
        task: what takes the steps.
        inputs: plain values that tell what the task works on; a checkpoint is used if they are the same.
        preview: writes the picture to show meanwhile to the path that it is given, by `save_image`.
        every: steps from one preview and checkpoint to the next; None: a few seconds.
        device: where the task computes; a checkpoint may come from another.
    """

    def __init__(
        self,
        folder: Path,
        task: Task,
        inputs: dict[str, Any],
        preview: Callable[[Path], None],
        every: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self._folder, self._task, self._inputs, self._preview, self._every = folder, task, inputs, preview, every
        self._checkpoint, self._device = folder / "checkpoint.pt", device
        self.history: list[dict[str, Any]] = []
        """What each step returned, and its phase."""
        self.seconds = 0.0
        """Time that the steps took, those before an interruption too."""

    def work(self, resume: bool) -> bool:
        """All steps that are left, after those of the checkpoint if ``resume``; False if Ctrl-C ended them early.

        Raises ValueError for a checkpoint of another task.
        """
        if resume and self._checkpoint.is_file():
            self._restore()
        task, begun, shown = self._task, time.monotonic() - self.seconds, self.seconds
        label, note = TextColumn("{task.description:<8}"), TextColumn("{task.fields[note]}")
        columns = label, BarColumn(), note, TimeElapsedColumn(), TimeRemainingColumn()
        with Progress(*columns, console=Console()) as progress, interruption() as interrupted:
            bars: dict[str, Any] = {}
            while not task.done and not interrupted:
                row = task.advance()
                self.history.append({"phase": task.phase, **{name: round(value, 6) for name, value in row.items()}})
                if task.phase not in bars:
                    bars[task.phase] = progress.add_task(task.phase, note="", completed=task.step - 1, total=task.steps)
                text = "  ".join(f"{name} {value:.4f}" for name, value in list(row.items())[:2])
                progress.update(bars[task.phase], completed=task.step, total=task.steps, note=text)
                self.seconds = time.monotonic() - begun
                if self.seconds - shown > _SECONDS if self._every is None else task.step % self._every == 0:
                    self._save()
                    shown = self.seconds
            self._save()
        return not interrupted

    def _save(self) -> None:
        """A preview and a checkpoint; whoever looks at the files meanwhile never finds half of one."""
        self._preview(self._folder / "preview.png")
        state = {"task": self._task.state_dict(), "history": self.history, "seconds": self.seconds}
        file = io.BytesIO()  # since torch.save does not say why it cannot write
        torch.save({**state, "inputs": self._inputs}, file)
        write_file(self._checkpoint, file.getbuffer())

    def _restore(self) -> None:
        try:
            state = load_tensors(self._checkpoint, self._device)
            inputs, task = state["inputs"], state["task"]
            self.history, self.seconds = state["history"], state["seconds"]
        except Exception as error:  # whatever torch says of a file that is none of ours
            raise ValueError(
                f"{self._checkpoint}: expected a checkpoint, got another file ({why_not_loaded(error)})"
            ) from None
        # What an older checkpoint does not know was not there to be chosen.
        names = [k for k in (self._inputs | inputs) if self._inputs.get(k) != inputs.get(k)]
        if names:
            mine, theirs = (", ".join(f"{k} {each.get(k)}" for k in names) for each in (self._inputs, inputs))
            raise ValueError(f"{self._checkpoint}: expected a checkpoint of this run ({mine}), got one of {theirs}")
        self._task.load_state_dict(task)


def fingerprint(value: Any) -> Any:
    """A setting as a checkpoint knows it: of a file its name and contents, wherever it lies."""
    return f"{value.name} #{zlib.crc32(value.read_bytes()):08x}" if isinstance(value, Path) else value
