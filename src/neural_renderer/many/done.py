"""`Done`: numbers that workers report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Done:
    """What was done: numbers of models, views and failures, seconds by part, and what to tell people.

    Attributes:
        models, views, failures: Numbers.
        seconds: Processor seconds by part of the work.
        problems, notes: Failures and warnings in words; sums do not keep them.
    """

    models: int = 0
    views: int = 0
    failures: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def add(self, other: Done) -> None:
        """Add the numbers of another."""
        self.models, self.views = self.models + other.models, self.views + other.views
        self.failures += other.failures
        for part, seconds in other.seconds.items():
            self.seconds[part] = self.seconds.get(part, 0.0) + seconds


Report = Callable[[Done], None]
"""Is told what has been done since the last time."""
