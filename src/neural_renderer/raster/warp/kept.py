"""Values of constants, such as the view of a camera, kept: torch's operators take longer than small kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from .launch import stream_of
from .registration import is_plain

R = TypeVar("R")

_kept: WeakKeyDictionary[Any, dict[str, tuple[Any, Any]]] = WeakKeyDictionary()


def kept_with(
    owner: Any, name: str, parts: Sequence[Any], device: torch.device, make: Callable[[], R], *options: Any
) -> R:
    """Return ``make()``, kept with its owner as the value of a name, until a tensor of its parts is changed in place.

    Other ``options`` are another value. Nothing is kept of parts that may have derivatives, or are neither tensors nor
    numbers, nor while a CUDA graph is captured, whose replays compute the value.
    """
    tensors = tuple([each for each in parts if isinstance(each, Tensor)])
    if not is_plain(tensors) or not all(map(_is_constant, parts)):
        return make()
    stream = stream_of(device)
    if stream is None:
        return make()
    state = device, stream, options, *(each._version for each in tensors)
    values = _kept.setdefault(owner, {})
    if name not in values or values[name][0] != state:
        with torch.inference_mode(False):
            values[name] = state, make()
    found: R = values[name][1]
    return found


def _is_constant(part: Any) -> bool:
    if isinstance(part, Tensor):
        return not (part.requires_grad or part.is_inference())
    return part is None or type(part) in (int, float) or (type(part) is tuple and {*map(type, part)} <= {int, float})
