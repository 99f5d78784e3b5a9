"""Layout: how the work of a launch is divided into tasks.

On the CPU a task is long, and no two tasks write to the same address. On CUDA a task is one of many thousands of short
threads, which share sums by atomics; reading a value would synchronise.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .memory import zeros
from .native import Call, struct

# Pieces per CPU thread, so that a slow piece does not leave the other threads idle.
PIECES = 4

# Numbers of pixels, to scan or to draw and shade, that justify another CPU thread.
MANY_PIXELS, _ENOUGH_PIXELS = 1 << 20, 1 << 13

_ROWS = 16  # rows of a CPU task, which share faces; even, so that both rows of a 2 × 2 block have one task
_MOST_TASKS = 2**31 - 1  # most tasks of one launch

# Set by tests: True for the layout of CUDA on the CPU (see `emulator` in `launch`), False for that of the CPU for
# tensors that emulate CUDA's.
as_on_cuda: bool | None = None


def concurrent(device: torch.device) -> bool:
    """Test whether the tasks of a launch run concurrently and share sums by atomics, as on CUDA."""
    return device.type == "cuda" if as_on_cuda is None else as_on_cuda


def readable(device: torch.device) -> bool:
    """Test whether values can be read without synchronising with the device."""
    return device.type == "cpu"


def in_any_order(device: torch.device) -> bool:
    """Test whether tasks may add atomically in any order: they are concurrent, and torch allows nondeterminism."""
    return concurrent(device) and not torch.are_deterministic_algorithms_enabled()


def cpu_bands(batch: int, pixels: int) -> int:
    """Choose a number of row bands per image that keeps all threads busy; ``pixels`` counts its pixels and faces."""
    threads = min(torch.get_num_threads(), max(1, batch * pixels // _ENOUGH_PIXELS))
    return 1 if batch % threads == 0 or batch >= PIECES * threads else 2 * threads


def worth_a_thread(pixels: float) -> int:
    """Compute how many tasks justify another CPU thread; each draws or shades ``pixels`` pixels."""
    return max(1, int(_ENOUGH_PIXELS / max(pixels, 1.0)))


def face_tasks(faces: Tensor, pixels: int) -> int:
    """Compute how many tasks justify another CPU thread; each draws one of ``faces`` [B, F, ...]."""
    return worth_a_thread(pixels / max(faces.shape[1], 1) + 32)  # a face costs as much as some pixels


def images_of(*tensors: Tensor) -> int:
    """Return the number of images of tensors with a batch of 1 or B each."""
    batches = [tensor.shape[0] for tensor in tensors]  # faster than len()
    return 0 if 0 in batches else max(batches)


def group_tasks(count: int, device: torch.device, on_cpu: int, on_cuda: int = 1) -> tuple[int, int]:
    """Compute the number of groups of ``count`` vertices or faces, one task each, and the size of a group."""
    each = on_cuda if concurrent(device) else on_cpu
    return -(-count // each), each


def pixel_tasks(rows: int, width: int, device: torch.device) -> tuple[int, int]:
    """Divide ``rows`` rows of pixels among tasks; `pixels_of_task` in `tasks.h` finds the pixels of a task.

    Returns the number of tasks, and the rows of a task. 0 stands for a single pixel, as on CUDA, where the accesses
    of a warp are then coalesced.
    """
    if not concurrent(device):
        return -(-rows // _ROWS), _ROWS
    return (rows * width, 0) if rows * width <= _MOST_TASKS else (rows, 1)


def run_tasks(rows: int, width: int) -> tuple[int, int]:
    """Divide rows of pixels into runs of 8, one sector of 32 bytes: the number of tasks, and the pixels of a run.

    A CUDA thread adds the sum of its run with one atomic.
    """
    return rows * -(-width // 8), 8


# A work queue on CUDA: one launch fills it with large faces, or those that have work, and the next launch shares it.
# Otherwise the GPU would wait for the few threads that process large triangles behind a fine mesh. See `queue.h`.

# Threads of a launch whose work only the device knows: about as many as a large GPU runs concurrently.
MOST_THREADS = 1 << 18


def empty_queue(faces: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Make an empty `Queue` of `queue.h`: its entries, [faces, 2] int64, and their total, [1] int64."""
    return torch.empty((faces, 2), dtype=torch.int64, device=device), zeros((2,), device, torch.int32).view(torch.int64)


_Queue = struct("queue.h", "Queue")


def queue_of(queue: tuple[Tensor, Tensor] | None, threads: int = 0) -> Call:
    """Make the `Queue` of kernels; ``threads`` of a launch take work from it. Null pointers without a queue."""
    return _Queue(entries=queue[0], total=queue[1], threads=threads) if queue else _Queue()


def line_threads(faces: int, queue: tuple[Tensor, Tensor] | None, lanes: int) -> int:
    """Compute the number of tasks of a launch by `for_each_line_task`: faces, or the threads that share the queue.

    ``lanes`` of them share each scan line.
    """
    return faces if queue is None else min(MOST_THREADS, 64 * faces * lanes)
