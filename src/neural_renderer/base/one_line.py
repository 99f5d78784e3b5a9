"""`repr` of one line for classes that hold tensors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from typing import Any

from torch import Tensor

from .validate import shape_of

_FEW = 4  # tensors of at most so many numbers are shown in full


class OneLine:
    """Base of dataclasses (``repr=False``) whose `repr` shows tensors by shape and dtype, and omits None."""

    def __repr__(self) -> str:
        parts = ((part.name, getattr(self, part.name)) for part in fields(self) if part.repr)  # type: ignore[arg-type]
        return one_line(type(self).__name__, parts)


def one_line(name: str, parts: Iterable[tuple[str, Any]]) -> str:
    """Format a name and its attributes on one line."""
    shown = (f"{key}={_short(value)}" for key, value in parts if value is not None)
    return f"{name}({', '.join(shown)})"


def _short(value: Any) -> str:
    if isinstance(value, Tensor):
        return repr(value) if value.ndim < 2 and value.numel() <= _FEW else shape_of(value)
    if isinstance(value, tuple) and value and isinstance(value[0], OneLine):
        return f"{len(value)} × {value[0]!r}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_short, value))})"
    if is_dataclass(value) and not isinstance(value, OneLine):
        return f"{type(value).__name__}(…)"
    return repr(value)
