"""`Memo`: results for tensors that have not changed."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

from torch import Tensor

_Value = TypeVar("_Value")


class Memo(Generic[_Value]):
    """Keeps results for tensors, as long as these live and are not changed in place. Any thread may call it.

    torch counts changes of a tensor, but neither those by ``tensor.data`` nor those by an array of numpy that shares
    its memory. ``holds`` can find these: it tells whether a result still belongs to a tensor without a counted change.
    """

    def __init__(self, most: int = 16, holds: Callable[[Tensor, _Value], bool] | None = None) -> None:
        self._most, self._holds = most, holds
        self._found: dict[int, tuple[weakref.ref[Tensor], int, _Value]] = {}
        self._lock = threading.Lock()

    def get(self, tensor: Tensor, make: Callable[[Tensor], _Value]) -> _Value:
        """Return ``make(tensor)``, or the result of an earlier call."""
        if tensor.is_inference():  # torch does not count its changes
            return make(tensor)
        key, version = id(tensor), tensor._version
        with self._lock:
            reference, known, value = self._found.get(key, (None, -1, None))
        is_known = reference is not None and reference() is tensor and known == version
        if is_known and (self._holds is None or self._holds(tensor, value)):  # type: ignore[arg-type]
            return value  # type: ignore[return-value]
        value = make(tensor)
        with self._lock:
            self._found.pop(key, None)
            while len(self._found) >= self._most:
                del self._found[next(iter(self._found))]
            self._found[key] = weakref.ref(tensor), version, value
        return value
