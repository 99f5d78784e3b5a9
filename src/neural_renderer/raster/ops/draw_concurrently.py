"""Draw all faces in parallel on CUDA; an atomic minimum of keys of depth and index finds the visible face.

A thread draws a small face, and many share a large one; see `raster/warp/queue.py`.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import Int4, pixel_box
from ..warp.launch import array, launch
from ..warp.layout import PIXELS_OF_TASK, pixel_tasks
from ..warp.queue import MOST_THREADS, empty_queue, enqueue, queued_face, queued_threads
from .draw_face import draw_into_keys
from .drawn_faces import crossing_depth, depth_terms, drawn_face

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

EMPTY = wp.constant(0x7FFFFFFF_FFFFFFFF)

# Pixels of the box of a small face.
_SMALL = wp.constant(64)
# Threads that share a row of a large face's box, unless it is narrower.
_LANES = wp.constant(32)


def draw_concurrently(faces: Tensor, face_index: Tensor, visible: Any, options: Sequence[float]) -> None:
    """Draw faces as `coverage` does.

    Args:
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Result, [B, H, W] int32; written.
        visible: Mask as of `visible_faces`, a kernel's argument; written, unless it is empty.
        options: near, far, two_sided and perspective of `coverage`.
    """
    device = faces.device
    batch, height, width = face_index.shape
    count = faces.shape[1]
    key = torch.full((batch, height, width), EMPTY, dtype=torch.int64, device=device)
    queue, total = empty_queue(batch * count, device)
    arguments = [array(faces, wp.vec3), array(key), array(queue), array(total), *options]
    launch(_draw_small, batch * count, arguments, device)
    threads = min(MOST_THREADS, batch * count * height * min(width, _LANES))
    launch(_draw_large, threads, [*arguments, threads], device)
    tasks, each = pixel_tasks(batch * height, width, device)
    launch(decode_keys, tasks, [array(key), array(face_index), visible, count, each], device)


@wp.func
def lanes_of(box: Int4) -> int:
    """Compute the number of threads that share a row of a box: enough that each has a few pixels at most."""
    lanes = int(_LANES)
    while lanes > 1 and 4 * lanes > box[1] - box[0] + 1:
        lanes = lanes // 2
    return lanes


@wp.func
def draw_part(
    key: wp.array3d(dtype=wp.int64),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    front: int,
    near: float,
    far: float,
    perspective: int,
    box: Int4,
    lane: int,
    lanes: int,
):
    """Draw every n-th pixel of each row of a box."""
    height = key.shape[1]
    width = key.shape[2]
    if front == 1:
        n, d = depth_terms(v0, v1, v2, perspective)
        draw_into_keys(
            key, b, index, v0, v1, v2, n, d, near, far, height, width, box[0], box[1], box[2], box[3], lane, lanes
        )
        return
    for j in range(box[2], box[3] + 1):
        for i in range(box[0] + lane, box[1] + 1, lanes):
            z = crossing_depth(v0, v1, v2, i, j, height, width)
            if z > near and z < far:
                candidate = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(index)
                wp.atomic_min(key, b, height - 1 - j, i, candidate)


@wp.kernel
def _draw_small(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
    """Draw one face, or put it into the queue."""
    task = first + wp.tid()
    b = task // faces.shape[1]
    f = task % faces.shape[1]
    front, index, v0, v1, v2 = drawn_face(faces, b, f, -1.0, 1.0, near, far, two_sided, perspective)
    if front < 0:
        return
    box = pixel_box(v0, v1, v2, front, key.shape[1], key.shape[2])
    if box[0] > box[1] or box[2] > box[3]:
        return
    if (box[1] - box[0] + 1) * (box[3] - box[2] + 1) <= _SMALL:
        draw_part(key, b, index, v0, v1, v2, front, near, far, perspective, box, 0, 1)
    else:
        enqueue(queue, total, task, (box[3] - box[2] + 1) * lanes_of(box))


@wp.kernel
def _draw_large(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
    threads: int,
):
    """Draw some pixels of a row of a large face; then of another, as long as there are any."""
    end = queued_threads(total)
    thread = wp.int64(first + wp.tid())
    while thread < end:
        task, own = queued_face(queue, total, thread)
        b = task // faces.shape[1]
        front, index, v0, v1, v2 = drawn_face(
            faces, b, task % faces.shape[1], -1.0, 1.0, near, far, two_sided, perspective
        )
        box = pixel_box(v0, v1, v2, front, key.shape[1], key.shape[2])
        lanes = lanes_of(box)
        row = box[2] + own // lanes
        part = Int4(box[0], box[1], row, row)
        draw_part(key, b, index, v0, v1, v2, front, near, far, perspective, part, own % lanes, lanes)
        thread += wp.int64(threads)


_DECODE = f"""
    const int width = face_index.shape[2], all = face_index.shape[0] * face_index.shape[1];
    {PIXELS_OF_TASK}
    const wp::int64 start = (wp::int64)first * width + left, stop = (wp::int64)(last - 1) * width + right;
    for (wp::int64 i = start; i < stop; ++i) {{
        const unsigned index = (unsigned)key.data[i];
        const int f = key.data[i] == empty ? -1 : (int)(index < (unsigned)count ? index : index - count);
        face_index.data[i] = f;
        if (visible.shape[0] > 0)  // several threads may write to one place, but all write 1
            visible.data[i / ((wp::int64)face_index.shape[1] * width) * (count + 1) + (f < 0 ? count : f)] = 1;
    }}
"""


@wp.func_native(_DECODE)
def decode(
    key: wp.array3d(dtype=wp.int64),
    face_index: wp.array3d(dtype=wp.int32),
    visible: wp.array2d(dtype=int),
    task: int,
    each: int,
    count: int,
    empty: wp.int64,
):
    """Convert the least keys of the pixels of a task to face indices, and mark these faces."""
    ...


@wp.kernel
def decode_keys(
    first: int,
    key: wp.array3d(dtype=wp.int64),
    face_index: wp.array3d(dtype=wp.int32),
    visible: wp.array2d(dtype=int),
    count: int,
    each: int,
):
    """Run `decode`; ``visible`` is empty where no faces are marked."""
    decode(key, face_index, visible, first + wp.tid(), each, count, wp.int64(EMPTY))
