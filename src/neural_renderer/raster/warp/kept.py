"""Values of constants, such as the view of a camera, kept: torch's operators take longer than small kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from ...base import private
from .launch import stream_of
from .registration import is_plain

R = TypeVar("R")

_NUMBERS = (torch.float32, torch.float64)
_MOST = 4096  # numbers of a tensor, which are compared in each call

_kept: WeakKeyDictionary[Any, dict[str, tuple[Any, Any]]] = WeakKeyDictionary()


def kept_with(
    owner: Any, name: str, parts: Sequence[Any], device: torch.device, make: Callable[[], R], *options: Any
) -> R:
    """Return ``make()``, kept with its owner as the value of a name, until a tensor of its parts changes.

    Each set of ``options`` has a value of its own. Nothing is kept if a part requires a gradient or is neither a small
    tensor nor a number, or while a CUDA graph is captured, because its replays compute the value.
    """
    tensors = tuple([each for each in parts if isinstance(each, Tensor)])
    if not is_plain(tensors) or not all(map(_is_constant, parts)):
        return make()
    stream = stream_of(device)
    if stream is None:
        return make()
    state = device, stream, options, *map(_state, tensors)
    values = _kept.setdefault(owner, {})
    if name not in values or values[name][0] != state:
        with torch.inference_mode(False):
            values[name] = state, make()
    found: R = values[name][1]
    return found


def _state(tensor: Tensor) -> Any:
    """Return the values on the CPU, where NumPy and ``.data`` change them without torch's counter; else the counter."""
    return tensor.numpy().tobytes() if tensor.is_cpu else private.version_of(tensor)


def _is_constant(part: Any) -> bool:
    if isinstance(part, Tensor):
        few = part.dtype in _NUMBERS and part.numel() <= _MOST
        return few and not part.requires_grad and private.version_of(part) is not None
    return part is None or type(part) in (int, float) or (type(part) is tuple and {*map(type, part)} <= {int, float})
