"""Checks of single numbers. This module imports neither torch nor NumPy, so that options can use it."""

from __future__ import annotations

import math
import sys
from typing import Any


def number(name: str, value: Any) -> float:
    """Convert ``value`` to a finite float; raise TypeError or ValueError otherwise."""
    try:
        if isinstance(value, str):  # float() accepts strings
            raise TypeError
        found = float(value.item() if hasattr(value, "item") else value)
    except OverflowError:  # an int with too many digits to show
        raise ValueError(f"{name}: expected a finite number, got one beyond {sys.float_info.max:.0e}") from None
    except (TypeError, ValueError, RuntimeError):
        got = f"{list(value.shape)} {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
        raise TypeError(f"{name}: expected a number, got {got.replace('torch.', '')}") from None
    if not -math.inf < found < math.inf:
        raise ValueError(f"{name}: expected a finite number, got {found}")
    return found


def positive(name: str, value: Any) -> float:
    """Convert ``value`` to a finite float > 0; raise TypeError or ValueError otherwise."""
    found = number(name, value)
    if found <= 0:
        raise ValueError(f"{name}: expected a finite number above 0, got {value}")
    return found


def not_negative(name: str, value: Any) -> float:
    """Convert ``value`` to a finite float ≥ 0; raise TypeError or ValueError otherwise."""
    found = number(name, value)
    if found < 0:
        raise ValueError(f"{name}: expected a number of at least 0, got {value}")
    return found


def whole(name: str, value: Any, least: int) -> int:
    """Convert ``value`` to an int ≥ ``least``; raise TypeError or ValueError otherwise."""
    found = number(name, value)
    if found != int(found):
        raise TypeError(f"{name}: expected a whole number, got {value}")
    if found < least:
        raise ValueError(f"{name}: expected at least {least}, got {value}")
    return int(found)


def fraction(name: str, value: Any) -> float:
    """Convert ``value`` to a float in [0, 1]; raise TypeError or ValueError otherwise."""
    found = number(name, value)
    if not 0 <= found <= 1:
        raise ValueError(f"{name}: expected a fraction in [0, 1], got {value}")
    return found
