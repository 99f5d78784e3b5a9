"""A queue of faces on CUDA: one launch fills it with large faces, or those that have work; the next shares the work.

Otherwise a few large triangles behind a fine mesh would keep the GPU waiting for the threads that have them.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import functools
from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from .geometry import pixel_box
from .launch import array, launch
from .layout import in_any_order
from .memory import zeros
from .native import Call, struct

# Threads of a launch whose work is known on the device only: about as many as a large GPU runs at once.
MOST_THREADS = 1 << 18

# The lower 36 bits of the total count threads, the upper bits count faces.
_FACE = wp.constant(1 << 36)


def empty_queue(faces: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Make an empty queue.

    Returns:
        The queue, [faces, 2] int64; each entry is a face number and the index of the face's first thread. The total,
        [1] int64: threads, plus faces times 2^36.
    """
    return torch.empty((faces, 2), dtype=torch.int64, device=device), zeros((2,), device, torch.int32).view(torch.int64)


@functools.cache
def _no_queue(device: torch.device) -> list[Any]:
    """Make the arguments that stand for a queue where there is none."""
    return [*map(array, empty_queue(0, device))]


def queue_arrays(queue: tuple[Tensor, Tensor] | None, device: torch.device) -> list[Any]:
    """Make the kernel arguments of a queue, which are empty if there is none."""
    return [*map(array, queue)] if queue else _no_queue(device)


def line_queue(faces: int, device: torch.device) -> tuple[Tensor, Tensor] | None:
    """Make an empty queue for `launch_lines`; None where each face has one task, which visits its lines in order."""
    return empty_queue(faces, device) if in_any_order(device) else None


def launch_lines(
    kernel: wp.Kernel,
    arguments: Sequence[Any],
    faces: int,
    queue: tuple[Tensor, Tensor] | None,
    lanes: int,
    device: torch.device,
    least: int = 1,
    most: int = MOST_THREADS,
) -> None:
    """Run a kernel for each face, or on CUDA for each one in a queue, with more threads if many scan lines cross it.

    Args:
        kernel: Takes, after ``arguments``, the queue and its total, the number of ``lanes`` and the number of threads
            of the launch, which is 0 without a queue. See `line_task`.
        arguments: As of `launch`.
        faces: Number of faces.
        queue: As from `line_queue`, filled by `enqueue_lines`.
        lanes: Threads on CUDA that share each line.
        device: As of `launch`.
        least: As of `launch`.
        most: Number of threads that share the queue at most.
    """
    if queue is None:
        launch(kernel, faces, [*arguments, *_no_queue(device), 1, 0], device, least)
    else:
        threads = min(MOST_THREADS, most, 64 * faces * lanes)
        launch(kernel, threads, [*arguments, *map(array, queue), lanes, threads], device)


_Queue = struct("queue.h", "Queue")


def queue_of(queue: tuple[Tensor, Tensor] | None, threads: int = 0) -> Call:
    """Make the `Queue` of kernels; ``threads`` of a launch take work from it. Of null pointers if there is none."""
    return _Queue(entries=queue[0], total=queue[1], threads=threads) if queue else _Queue()


def line_threads(faces: int, queue: tuple[Tensor, Tensor] | None, lanes: int, most: int = MOST_THREADS) -> int:
    """Compute the number of tasks of a launch by `for_each_line_task`: faces, or the threads that share the queue.

    Args:
        faces: Number of faces of all images.
        queue: As from `line_queue`.
        lanes: Threads on CUDA that share each scan line.
        most: Number of threads that share the queue at most.
    """
    return faces if queue is None else min(MOST_THREADS, most, 64 * faces * lanes)


@wp.func
def enqueue(queue: wp.array2d(dtype=wp.int64), total: wp.array1d(dtype=wp.int64), face: int, threads: int):
    """Put a face into the queue, with its number of threads. One addition counts both, so threads ascend by entry."""
    before = wp.atomic_add(total, 0, wp.int64(_FACE) + wp.int64(threads))
    place = int(before / wp.int64(_FACE))
    queue[place, 0] = wp.int64(face)
    queue[place, 1] = before % wp.int64(_FACE)


@wp.func
def queued_threads(total: wp.array1d(dtype=wp.int64)) -> wp.int64:
    """Read the number of threads for all faces of the queue."""
    return total[0] % wp.int64(_FACE)


@wp.func
def queued_face(queue: wp.array2d(dtype=wp.int64), total: wp.array1d(dtype=wp.int64), thread: wp.int64):
    """Find the face of a thread, and the thread's number among those of the face."""
    low = int(0)
    high = int(total[0] / wp.int64(_FACE))
    while high - low > 1:  # the last face that begins before
        middle = (low + high) // 2
        if queue[middle, 1] <= thread:
            low = middle
        else:
            high = middle
    return int(queue[low, 0]), int(thread - queue[low, 1])


@wp.func
def line_parts(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, height: int, width: int, most: int) -> int:
    """Compute the number of threads that share the scan lines of a face: a power of 2, ``most`` lines each at most."""
    box = pixel_box(v0, v1, v2, 1, height, width)
    lines = box[1] - box[0] + box[3] - box[2]
    parts = int(1)
    while most * parts < lines:
        parts = 2 * parts
    return parts


@wp.func
def enqueue_lines(
    faces: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    height: int,
    width: int,
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    lanes: int,
    most: int,
):
    """Put a face into the queue of `launch_lines`: ``lanes`` threads each have ``most`` of its scan lines at most."""
    parts = line_parts(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], height, width, most)
    enqueue(queue, total, b * faces.shape[1] + f, parts * lanes)


@wp.func
def line_task(
    faces: wp.array3d(dtype=wp.vec3),
    height: int,
    width: int,
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    lanes: int,
    thread: wp.int64,
    most: int,
):
    """Find the work of a thread of `launch_lines`, which has ``most`` scan lines of a face at most, or all of it.

    Returns:
        The number of the face, counted over all images. The lane, of ``lanes``: the pixels of a line that the thread
        has. The part, and the number of parts: the lines that it has.
    """
    face = int(thread)
    own = int(0)
    parts = int(1)
    if queue.shape[0] > 0:
        face, own = queued_face(queue, total, thread)
        b = face // faces.shape[1]
        f = face % faces.shape[1]
        parts = line_parts(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], height, width, most)
    return face, own % lanes, own // lanes, parts
