"""`Memo`: results for tensors that have not changed."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

from torch import Tensor

_Value = TypeVar("_Value")


class Memo(Generic[_Value]):
    """Keeps results for tensors, as long as these live and are not changed in place. For any thread.

    Args:
        most: Number of results kept.
    """

    def __init__(self, most: int = 16) -> None:
        self._most = most
        self._found: dict[int, tuple[weakref.ref[Tensor], int, _Value]] = {}
        self._lock = threading.Lock()

    def get(self, tensor: Tensor, make: Callable[[Tensor], _Value]) -> _Value:
        """Return ``make(tensor)``, or the result of an earlier call."""
        if tensor.is_inference():  # changes of these are not counted
            return make(tensor)
        key, version = id(tensor), tensor._version
        with self._lock:
            reference, known, value = self._found.get(key, (None, -1, None))
        if reference is not None and reference() is tensor and known == version:
            return value  # type: ignore[return-value]
        value = make(tensor)
        with self._lock:
            self._found.pop(key, None)
            while len(self._found) >= self._most:
                del self._found[next(iter(self._found))]
            self._found[key] = weakref.ref(tensor), version, value
        return value
