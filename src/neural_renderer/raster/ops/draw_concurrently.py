"""Drawing faces on CUDA, for `coverage`: all at once, into keys of depth and index of which the least one is visible.

A thread draws a small face. Large faces go to a queue, and a second launch shares their pixels among all threads:
otherwise a few triangles behind a fine mesh would keep the GPU waiting for a few threads.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import Int4, pixel_box
from ..warp.launch import array, launch, zeros
from ..warp.layout import MOST_THREADS, PIXELS_OF_TASK, pixel_tasks
from .draw_face import draw_into_keys
from .drawn_faces import crossing_depth, depth_terms, drawn_face

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

EMPTY = wp.constant(0x7FFFFFFF_FFFFFFFF)

# Pixels of the box of a small face.
_SMALL = wp.constant(64)
# Threads that share a row of a large face's box, unless it is narrower.
_LANES = wp.constant(32)
# The number of large faces counts in this, the number of their threads in 1.
_ONE_FACE = wp.constant(1 << 36)


def draw_concurrently(faces: Tensor, face_index: Tensor, options: Sequence[float]) -> None:
    """Draw faces as `coverage` does.

    Args:
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Result, [B, H, W] int32; written.
        options: near, far, two_sided and perspective of `coverage`.
    """
    device = faces.device
    batch, height, width = face_index.shape
    count = faces.shape[1]
    key = torch.full((batch, height, width), EMPTY, dtype=torch.int64, device=device)
    large = torch.empty((batch * count, 2), dtype=torch.int64, device=device)
    total = zeros((2,), device, torch.int32).view(torch.int64)
    arguments = [array(faces, wp.vec3), array(key), array(large), array(total), *options]
    launch(_draw_small, batch * count, arguments, device)
    threads = min(MOST_THREADS, batch * count * height * min(width, _LANES))
    launch(_draw_large, threads, [*arguments, threads], device)
    tasks, each = pixel_tasks(batch * height, width, device)
    launch(_decode, tasks, [array(key), array(face_index), count, each], device)


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
    large: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
    """Draw one face, or put it into the queue: its number, and the number of its first thread among those of all."""
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
        return
    threads = wp.int64((box[3] - box[2] + 1) * lanes_of(box))
    before = wp.atomic_add(total, 0, wp.int64(_ONE_FACE) + threads)  # both at once: the queue is in order of threads
    place = int(before / wp.int64(_ONE_FACE))
    large[place, 0] = wp.int64(task)
    large[place, 1] = before % wp.int64(_ONE_FACE)


@wp.kernel
def _draw_large(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    large: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
    threads: int,
):
    """Draw some pixels of a row of a large face; then of another, as long as there are any."""
    count = int(total[0] / wp.int64(_ONE_FACE))
    end = total[0] % wp.int64(_ONE_FACE)
    unit = wp.int64(first + wp.tid())
    while unit < end:
        low = int(0)
        high = int(count)
        while high - low > 1:  # the last face that begins before
            middle = (low + high) // 2
            if large[middle, 1] <= unit:
                low = middle
            else:
                high = middle
        task = int(large[low, 0])
        own = int(unit - large[low, 1])
        b = task // faces.shape[1]
        front, index, v0, v1, v2 = drawn_face(
            faces, b, task % faces.shape[1], -1.0, 1.0, near, far, two_sided, perspective
        )
        box = pixel_box(v0, v1, v2, front, key.shape[1], key.shape[2])
        lanes = lanes_of(box)
        row = box[2] + own // lanes
        part = Int4(box[0], box[1], row, row)
        draw_part(key, b, index, v0, v1, v2, front, near, far, perspective, part, own % lanes, lanes)
        unit += wp.int64(threads)


_DECODE = f"""
    const int width = face_index.shape[2], all = face_index.shape[0] * face_index.shape[1];
    {PIXELS_OF_TASK}
    const wp::int64 start = (wp::int64)first * width + left, stop = (wp::int64)(last - 1) * width + right;
    for (wp::int64 i = start; i < stop; ++i) {{
        const unsigned index = (unsigned)key.data[i];
        face_index.data[i] = key.data[i] == empty ? -1 : (int)(index < (unsigned)count ? index : index - count);
    }}
"""


@wp.func_native(_DECODE)
def decode(
    key: wp.array3d(dtype=wp.int64),
    face_index: wp.array3d(dtype=wp.int32),
    task: int,
    each: int,
    count: int,
    empty: wp.int64,
):
    """Convert the least keys of the pixels of a task to face indices."""
    ...


@wp.kernel
def _decode(first: int, key: wp.array3d(dtype=wp.int64), face_index: wp.array3d(dtype=wp.int32), count: int, each: int):
    decode(key, face_index, first + wp.tid(), each, count, wp.int64(EMPTY))
