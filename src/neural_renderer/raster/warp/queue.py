"""A queue of faces on CUDA: one launch fills it with large faces, or those that have work; the next shares the work.

Otherwise a few large triangles behind a fine mesh would keep the GPU waiting for the threads that have them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .memory import zeros
from .native import Call, struct

# Threads of a launch whose work is known on the device only: about as many as a large GPU runs at once.
MOST_THREADS = 1 << 18


def empty_queue(faces: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Make an empty `Queue` of `queue.h`: its entries, [faces, 2] int64, and their total, [1] int64."""
    return torch.empty((faces, 2), dtype=torch.int64, device=device), zeros((2,), device, torch.int32).view(torch.int64)


_Queue = struct("queue.h", "Queue")


def queue_of(queue: tuple[Tensor, Tensor] | None, threads: int = 0) -> Call:
    """Make the `Queue` of kernels; ``threads`` of a launch take work from it. Null pointers without a queue."""
    return _Queue(entries=queue[0], total=queue[1], threads=threads) if queue else _Queue()


def line_threads(faces: int, queue: tuple[Tensor, Tensor] | None, lanes: int, most: int = MOST_THREADS) -> int:
    """Compute the number of tasks of a launch by `for_each_line_task`: faces, or the threads that share the queue.

    These are at most ``most``; ``lanes`` of them share each scan line.
    """
    return faces if queue is None else min(MOST_THREADS, most, 64 * faces * lanes)
