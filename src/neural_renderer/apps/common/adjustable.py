"""Base classes of iterative tasks: saving and resuming between steps, and changing the rate and weights of a fit."""

from __future__ import annotations

import warnings
from typing import Any

import torch

from ...base import validate
from .observer import LEAST_RATE, Knob, weight_knobs, with_weight


class Resumable:
    """A task of many steps. Its methods are documented here, once for all subclasses."""

    def adjust(self, name: str, value: float | str) -> None:
        """Change a setting. `state_dict` does not contain it.

        Args:
            name: Its name, as in `knobs`.
            value: Its new value.

        Raises:
            TypeError, ValueError: There is no such setting, or the value does not fit.
        """
        raise NotImplementedError

    def turn(self, name: str, value: float | str) -> None:
        """Call `adjust`, whose name this was in version 2.1.

        Args:
            name, value: As in `adjust`.

        Raises:
            TypeError, ValueError: As `adjust`.

        Warns:
            DeprecationWarning: Always.
        """
        warnings.warn("turn is adjust since version 2.2", DeprecationWarning, stacklevel=2)
        self.adjust(name, value)

    def state_dict(self) -> dict[str, Any]:
        """Collect everything that changes from step to step.

        Returns:
            Numbers and tensors by name, for `load_state_dict`. Later steps may change them; `torch.save` copies them.
        """
        raise NotImplementedError

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from the state of a task with the same inputs: views, image, shape.

        Args:
            state: Result of `state_dict`.

        Raises:
            KeyError: A name is missing.
        """
        raise NotImplementedError


class Adjustable(Resumable):
    """A fit with a rate, and perhaps with weights of losses, that a viewer may change.

    Subclasses set ``_rate``, a number > 0, and ``_weights``, a dataclass of numbers ≥ 0, or None.
    """

    step: int
    steps: int
    _rate: float
    _weights: Any = None

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    def knobs(self) -> list[Knob]:
        """List the settings that may change between two steps.

        Returns:
            "rate", the length of a step, and the weights of the losses, if there are any.
        """
        return [Knob("rate", self._rate, LEAST_RATE), *weight_knobs(self._weights)]

    def adjust(self, name: str, value: float | str) -> None:
        if name == "rate":
            self._rate = validate.positive(name, value)
        else:
            self._weights = with_weight(self._weights, name, value)


def generator(seed: int, step: int) -> torch.Generator:
    """Make a random generator that depends on seed and step only, so that a resumed run equals an uninterrupted one."""
    return torch.Generator().manual_seed((1_000_003 * seed + step) % 2**63)
