"""Numbers that come from a GPU later, so that nothing waits for them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def send(number: Tensor) -> tuple[Tensor, Callable[[], bool]]:
    """Copy a number from CUDA to the host without waiting: the copy, and a function that tests whether it is there."""
    copy = torch.empty((), dtype=number.dtype, device="cpu", pin_memory=True)
    copy.copy_(number, non_blocking=True)
    event = torch.cuda.Event()
    event.record(torch.cuda.current_stream(number.device))
    return copy, event.query
