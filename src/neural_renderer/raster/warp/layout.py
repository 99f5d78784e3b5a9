"""Layout: how the work of a launch is divided into tasks.

On the CPU a task is long, and no two tasks write to one place. On CUDA a task is a short thread of many thousands;
threads share sums by atomics, and reading a number would wait for the device.
"""

from __future__ import annotations

import torch
from torch import Tensor

# Pieces per CPU thread: enough that one slow piece does not leave the others waiting.
PIECES = 4

# Numbers of pixels, to scan or to draw and shade, for which it is worth waking another CPU thread.
MANY_PIXELS, _ENOUGH_PIXELS = 1 << 20, 1 << 13

_ROWS = 16  # rows of a CPU task: neighbouring rows share faces
_MOST_TASKS = 2**31 - 1  # most tasks of one launch

# Tests set it, to run the layout of CUDA, and its code, on a processor (see `emulator` in `launch`), or that of the CPU
# for tensors that stand for some on CUDA.
as_on_cuda: bool | None = None


def concurrent(device: torch.device) -> bool:
    """Test whether the tasks of a launch run concurrently and share sums by atomics, as on CUDA."""
    return device.type == "cuda" if as_on_cuda is None else as_on_cuda


def readable(device: torch.device) -> bool:
    """Test whether numbers of a tensor can be read without waiting for the device."""
    return device.type == "cpu"


def in_any_order(device: torch.device) -> bool:
    """Test whether tasks may share sums and places in any order: they are concurrent, and torch allows it."""
    return concurrent(device) and not torch.are_deterministic_algorithms_enabled()


def cpu_bands(batch: int, pixels: int) -> int:
    """Choose a number of row bands per image that keeps all threads busy; ``pixels`` counts its pixels and faces."""
    threads = min(torch.get_num_threads(), max(1, batch * pixels // _ENOUGH_PIXELS))
    return 1 if batch % threads == 0 or batch >= PIECES * threads else 2 * threads


def worth_a_thread(pixels: float) -> int:
    """Compute how many tasks are worth another CPU thread; each draws or shades ``pixels`` pixels."""
    return max(1, int(_ENOUGH_PIXELS / max(pixels, 1.0)))


def face_tasks(faces: Tensor, pixels: int) -> int:
    """Compute how many tasks are worth another CPU thread; each draws one of ``faces`` [B, F, ...]."""
    return worth_a_thread(pixels / max(faces.shape[1], 1) + 32)  # a face costs as much as some pixels


def images_of(*tensors: Tensor) -> int:
    """Return the number of images of tensors with a batch of 1 or B each."""
    batches = [tensor.shape[0] for tensor in tensors]  # not len(), which is Python code in torch
    return 0 if 0 in batches else max(batches)


def group_tasks(count: int, device: torch.device, on_cpu: int, on_cuda: int = 1) -> tuple[int, int]:
    """Compute the number of groups of ``count`` vertices or faces, one task each, and the size of a group."""
    each = on_cuda if concurrent(device) else on_cpu
    return -(-count // each), each


def pixel_tasks(rows: int, width: int, device: torch.device) -> tuple[int, int]:
    """Divide ``rows`` rows of pixels among tasks; `pixels_of_task` in `tasks.h` finds the pixels of a task.

    Returns the number of tasks, and the rows of a task. 0 stands for a single pixel, as on CUDA, where the threads of a
    warp then read and write side by side.
    """
    if not concurrent(device):
        return -(-rows // _ROWS), _ROWS
    return (rows * width, 0) if rows * width <= _MOST_TASKS else (rows, 1)


def run_tasks(rows: int, width: int) -> tuple[int, int]:
    """Divide rows of pixels into runs of 8, one sector of 32 bytes: the number of tasks, and the pixels of a run.

    A CUDA thread adds the sum of its run with one atomic.
    """
    return rows * -(-width // 8), 8
