"""Numbers that come from a GPU later: nothing waits for them, and in a CUDA graph there are none before a replay."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def capturing(device: torch.device) -> bool:
    """Test whether torch's current stream captures a CUDA graph on a device; its tensors must not be cached."""
    return device.type == "cuda" and torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing()


def send(numbers: Tensor) -> tuple[Tensor, Callable[[], bool]]:
    """Copy numbers from CUDA to the host without waiting: the copy, and a function that tests whether it is there.

    While a CUDA graph is captured, which forbids the test, it is not there.
    """
    device = numbers.device
    copy = torch.empty(numbers.shape, dtype=numbers.dtype, device="cpu", pin_memory=True)
    copy.copy_(numbers, non_blocking=True)
    event = torch.cuda.Event()
    event.record(torch.cuda.current_stream(device))
    return copy, lambda: not capturing(device) and event.query()
