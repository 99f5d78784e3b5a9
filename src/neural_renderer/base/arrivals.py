"""Numbers that come from a GPU later, so that nothing waits for them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .capture import capturing


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
