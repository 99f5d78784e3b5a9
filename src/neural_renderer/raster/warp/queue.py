"""A queue of large faces on CUDA: one launch draws small faces and fills it, and the next shares the large ones.

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
    return [*map(array, empty_queue(0, device)), 1, 0]


def launch_lines(
    kernel: wp.Kernel, arguments: Sequence[Any], faces: int, lanes: int, device: torch.device, least: int = 1
) -> None:
    """Run a kernel for each face, with more threads for faces that many scan lines cross.

    Args:
        kernel: Takes, after ``arguments``, the queue and its total, the number of ``lanes`` and the number of threads
            of a launch for the faces of the queue, which is 0 in a launch for all faces. See `line_task`.
        arguments: As of `launch`.
        faces: Number of faces.
        lanes: Threads on CUDA that share each line.
        device: As of `launch`.
        least: As of `launch`.
    """
    if not in_any_order(device):
        launch(kernel, faces, [*arguments, *_no_queue(device)], device, least)
        return
    queue, total = map(array, empty_queue(faces, device))
    launch(kernel, faces * lanes, [*arguments, queue, total, lanes, 0], device)
    threads = min(MOST_THREADS, 64 * faces * lanes)
    launch(kernel, threads, [*arguments, queue, total, lanes, threads], device)


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
def line_task(
    faces: wp.array3d(dtype=wp.vec3),
    height: int,
    width: int,
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    lanes: int,
    threads: int,
    thread: wp.int64,
    most: int,
):
    """Find the work of a thread of `launch_lines`, which has ``most`` scan lines of a face at most.

    Returns:
        The number of the face, counted over all images; or -1 if it was put into the queue. The lane, of ``lanes``: the
        pixels of a line that the thread has. The part, and the number of parts: the lines that it has.
    """
    face = int(thread) // lanes
    own = int(thread) % lanes
    if threads > 0:
        face, own = queued_face(queue, total, thread)
    parts = int(1)
    if queue.shape[0] > 0:
        b = face // faces.shape[1]
        f = face % faces.shape[1]
        parts = line_parts(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], height, width, most)
        if threads == 0 and parts > 1:
            if own == 0:
                enqueue(queue, total, face, parts * lanes)
            face = -1
    return face, own % lanes, own // lanes, parts
