"""Observers, such as the viewer, see the meshes and losses of a running task, and may change settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol, TypeVar

from ...base import validate

LEAST_RATE = 1e-9
"""Least value of a learning rate that must be positive."""
_POLL = 0.05  # seconds between two looks at a paused task
_Weights = TypeVar("_Weights")


@dataclass(frozen=True)
class Knob:
    """A setting of a task that may change between two steps."""

    name: str
    value: float | str
    least: float = 0.0  # limits of a number
    most: float = 1e9
    choices: tuple[str, ...] = ()  # values of a setting that is no number


def weight_knobs(weights: Any) -> list[Knob]:
    """Make knobs of the loss weights in a dataclass; no knobs for None."""
    return [] if weights is None else [Knob(name, float(value)) for name, value in asdict(weights).items()]


def with_weight(weights: _Weights, name: str, value: float | str) -> _Weights:
    """Replace one of the loss weights by a value ≥ 0; raise ValueError for an unknown name."""
    if weights is None or name not in asdict(weights):  # type: ignore[call-overload]
        raise ValueError(f"name: expected a setting that can change, got {name!r}")
    return replace(weights, **{name: validate.not_negative(name, value)})  # type: ignore[type-var]


class Observer(Protocol):
    """Observer of a task's steps, which can pause and stop it.

    Attributes:
        paused: Whether the task is to wait.
        stopped: Whether the task is to end after this step, and keep its result.
    """

    @property
    def paused(self) -> bool: ...
    @property
    def stopped(self) -> bool: ...

    def observe(
        self, phase: str, step: int, steps: int, numbers: Mapping[str, float], mesh: Callable[[], Any], /
    ) -> None:
        """See a step of a task.

        Args:
            phase, step, steps: Name of the phase, number of steps taken in it, and number of its steps.
            numbers: Losses and measures of the step.
            mesh: Makes the current mesh, or several by name. Called in this thread, at some of the steps only.

        Raises:
            RuntimeError: The observer is closed.
        """
        ...

    def offer(self, knobs: Sequence[Knob], /) -> None:
        """Learn which settings may change.

        Args:
            knobs: The settings.
        """
        ...

    def changes(self) -> dict[str, float | str]:
        """Return changes of settings since the last call.

        Returns:
            Values by name.
        """
        ...


def goes_on(observer: Observer | None, interrupted: Sequence[int] = ()) -> bool:
    """Wait while a task is paused; return whether it continues. A signal in ``interrupted`` (Ctrl-C) ends the wait."""
    if observer is None:
        return True
    while observer.paused and not observer.stopped and not interrupted:
        time.sleep(_POLL)
    return not observer.stopped
