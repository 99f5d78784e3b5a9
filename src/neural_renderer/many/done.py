"""`Done`: numbers that workers report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Done:
    """Numbers of what was done, processor seconds by part of the work, and words for people, which sums do not keep."""

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
"""Is told what has been done since the last time."""
