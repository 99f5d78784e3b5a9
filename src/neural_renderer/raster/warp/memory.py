"""Memory of tensors that kernels write: on the CPU a pool, so that the images of the next step reuse it.

New memory costs time: the system clears each page at its first use, which took a third of a step in colour.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ...base.recording import Unrepeatable, recorder

# Bytes of the smallest pooled tensor (smaller ones are fast to allocate), and of the whole pool.
LEAST, MOST = 1 << 20, 1 << 28
MOST_CLEARED = MOST // 8  # bytes of the largest pooled tensor of zeros

DTYPES = {torch.float32: np.float32, torch.int32: np.int32, torch.int64: np.int64, torch.uint8: np.uint8}

# Unused memory, the oldest first. Tensors are freed on any thread, so each change of the dictionary is atomic.
_free: dict[int, np.ndarray] = {}


def empty(shape: Sequence[int], device: torch.device, dtype: torch.dtype = torch.float32) -> Tensor:
    """Make an uninitialised tensor, float32, int32, int64 or uint8."""
    if device.type != "cpu":
        return torch.empty(shape, dtype=dtype, device=device)
    size = np.dtype(DTYPES[dtype]).itemsize * math.prod(shape)
    if size < LEAST:
        made = torch.from_numpy(np.empty(shape, DTYPES[dtype]))
        if recording := recorder():
            recording.hold(made, "made")
        return made
    if recorder():
        raise Unrepeatable("large tensors are made from the pool")
    memory = _take(size)
    values = memory[:size].view(DTYPES[dtype]).reshape(tuple(shape))
    # torch holds `values` as long as a tensor, a view of it or a graph needs them.
    weakref.finalize(values, _keep, memory).atexit = False
    return torch.from_numpy(values)


def zeros(shape: Sequence[int], device: torch.device, dtype: torch.dtype = torch.float32) -> Tensor:
    """Make a tensor of zeros, float32 or int32.

    On the CPU memory of the pool is cleared, which takes less time than new pages. The system provides zeroed pages for
    large tensors, of which a kernel may touch few. torch would write zeros with all its threads, which then spin for a
    while on the processors that a kernel needs.
    """
    if device.type != "cpu":
        return torch.zeros(shape, dtype=dtype, device=device)
    if LEAST <= 4 * math.prod(shape) <= MOST_CLEARED:
        result = empty(shape, device, dtype)
        result.numpy()[...] = 0
        return result
    made = torch.from_numpy(np.zeros(tuple(shape), DTYPES[dtype]))
    if recording := recorder():
        recording.hold(made, "made", is_zero=True)
    return made


def contiguous(tensor: Tensor) -> Tensor:
    """Return a tensor for a kernel to read: itself, or a contiguous copy, on the CPU without torch's threads."""
    if tensor.is_contiguous() or tensor.device.type != "cpu" or tensor.dtype not in DTYPES or recorder():
        return tensor.contiguous()
    result = empty(tensor.shape, tensor.device, tensor.dtype)
    np.copyto(result.numpy(), tensor.detach().numpy())
    return result


def _take(size: int) -> np.ndarray:
    """Return pooled memory of at least this size, and less than twice as much, or new memory."""
    for memory in reversed(list(_free.values())):  # the last one used may still lie in the processor's cache
        if size <= memory.size < 2 * size and _free.pop(id(memory), None) is not None:
            return memory
    return np.empty(size, np.uint8)


def _keep(memory: np.ndarray) -> None:
    """Return unused memory to the pool, and free the oldest if the pool becomes too large."""
    if memory.size > MOST:
        return
    _free[id(memory)] = memory
    kept = list(_free.values())
    total = sum(each.size for each in kept)
    for each in kept:
        if total <= MOST:
            break
        if _free.pop(id(each), None) is not None:
            total -= each.size
