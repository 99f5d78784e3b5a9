"""Scan lines of an image for the edge estimators: pixels stored side by side.

The loops are plain C++ over memory, because compilers turn those into vector instructions.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import math

import torch
import warp as wp
from torch import Tensor

from ..ops.visible_faces import pixels_of_task
from ..warp.layout import PIXELS_OF_TASK, concurrent
from ..warp.memory import empty
from ..warp.point import fill
from ..warp.queue import enqueue_lines

wp.set_module_options({"enable_backward": False})

# Pixels of a scan line that the CPU handles at once. There, WIDE zeros pad each stored line in front, and the last one
# at its end, too.
WIDE = 16


def empty_lines(batch: int, lines: int, length: int, planes: int, device: torch.device) -> Tensor:
    """Allocate scan lines, [batch, lines, planes, WIDE + length] float32.

    Plane 0 holds the sum over channels of value times gradient. The other planes hold the gradients of the first
    channels. A silhouette has one plane, the gains: if covering the pixel lowers the loss, the decrease; if uncovering
    it does, minus the decrease.
    """
    shape = (batch, lines, planes, WIDE + length)
    room = empty((math.prod(shape) + WIDE,), device)
    if not concurrent(device):
        room[-WIDE:] = 0
    return room[:-WIDE].view(shape)


_COPY = """
    #pragma clang fp contract(fast)
    const int channels = image.shape[1], height = face_index.shape[1], width = face_index.shape[2];
    const wp::int64 area = (wp::int64)height * width, next = planes * plane;
    float* stored = lines.data + line;
    for (int k = 0; k < count * planes; ++k)
        for (int i = 1; i <= 16; ++i) stored[k * plane - i] = 0.0f;
    const float *value = image.data + b * channels * area + pixel, *pull = grad.data + b * channels * area + pixel;
    const int* shown = face_index.data + b * area + pixel;
    const auto gain_of = [](float gain, int face) {
        const float covered = face >= 0 ? 1.0f : 0.0f;
        return gain > 0.0f ? gain * (1.0f - covered) : gain * covered;
    };
    if (planes == 1 && grad.shape[3] < width) {  // a pixel has a quarter of the gradient of its block
        pull = grad.data + b * (area / 4) + pixel / width / 2 * (width / 2) + pixel % width / 2;
        PAIRS {
            const float gain = -0.25f * pull[block];
            stored[to] = gain_of(gain, shown[from]), stored[to + APART] = gain_of(gain, shown[from + 1]);
        }
    } else if (planes == 1) {
        pull = grad.data + b * area + pixel;
        EACH stored[to] = gain_of(-pull[from], shown[from]);
    } else if (planes == 4) {  // the usual three channels at once, in the order of the loop below
        const float *green = value + area, *blue = green + area, *by_green = pull + area, *by_blue = by_green + area;
        float *to_red = stored + plane, *to_green = to_red + plane, *to_blue = to_green + plane;
        EACH {
            float sum = value[from] * pull[from];
            sum += green[from] * by_green[from];
            sum += blue[from] * by_blue[from];
            stored[to] = sum;
            to_red[to] = pull[from], to_green[to] = by_green[from], to_blue[to] = by_blue[from];
        }
    } else {
        EACH stored[to] = 0.0f;
        for (int c = 0; c < planes - 1; ++c, value += area, pull += area) {
            // The same sum as in `ScanLine::loss`: a pixel that has the new colour already gains exactly 0.
            float* pulls = stored + (c + 1) * plane;
            EACH {
                stored[to] += value[from] * pull[from];
                pulls[to] = pull[from];
            }
        }
    }
    for (int k = 0; k < count; ++k) {
        int low = length, high = -1;
        for (int c = planes == 1 ? 0 : 1; c < planes; ++c) {
            const float* line_of = stored + k * next + c * plane;
            for (int v = 0; v < low; ++v) if (planes == 1 ? line_of[v] > 0.0f : line_of[v] != 0.0f) low = v;
            for (int v = length - 1; v > high; --v) if (planes == 1 ? line_of[v] > 0.0f : line_of[v] != 0.0f) high = v;
        }
        spans.data[span + k] = wp::vec_t<2, int>(length - low, high + 1);
    }
"""


@wp.func_native(
    fill(
        _COPY,
        EACH="for (int from = 0, to = 0; to < length; ++from, ++to)",
        PAIRS="for (int block = 0, from = 0, to = 0; to < length; ++block, from += 2, to += 2)",
        APART="1",
    )
)
def copy_row(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    b: int,
    pixel: wp.int64,
    count: int,
    length: int,
    lines: wp.array4d(dtype=float),
    line: wp.int64,
    plane: wp.int64,
    planes: int,
    spans: wp.array2d(dtype=wp.vec2i),
    span: wp.int64,
):
    """Store the row of ``length`` pixels that starts at ``pixel`` of image ``b`` at ``line``, and its span."""
    ...


@wp.func_native(
    fill(
        _COPY,
        EACH="for (int v = 0; v < length; ++v) for (wp::int64 k = 0, from = -(wp::int64)v * width, to = v;"
        " k < count; ++k, ++from, to += next)",
        PAIRS="for (int v = 0; v < length; ++v) for (wp::int64 k = 0, from = -(wp::int64)v * width, to = v,"
        " block = -(wp::int64)(v / 2) * (width / 2); k < count; k += 2, from += 2, to += 2 * next, ++block)",
        APART="next",
    )
)
def copy_columns(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    b: int,
    pixel: wp.int64,
    count: int,
    length: int,
    lines: wp.array4d(dtype=float),
    line: wp.int64,
    plane: wp.int64,
    planes: int,
    spans: wp.array2d(dtype=wp.vec2i),
    span: wp.int64,
):
    """Store ``count`` neighbouring columns, the first of which starts at ``pixel``, and their spans."""
    ...


@wp.kernel
def copy_lines(
    first: int,
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    abreast: int,
):
    """Copy ``abreast`` neighbouring rows or columns of an image. Lines and pixels count from the bottom left.

    With one plane, they are those of the silhouette of ``face_index``, and ``abreast`` is even.

    A line's span is from the first to the last pixel that can pull an edge outward: stored as the number of pixels from
    the first one to the end of the line, and from its start to the last one.
    """
    task = first + wp.tid()
    height = face_index.shape[1]
    width = face_index.shape[2]
    planes = rows.shape[2]
    row_tasks = (height + abreast - 1) // abreast
    tasks = row_tasks + (width + abreast - 1) // abreast
    b = task // tasks
    own = task % tasks
    bottom = wp.int64(height - 1) * wp.int64(width)
    span = wp.int64(b) * wp.int64(height + width)
    if own < row_tasks:
        plane = wp.int64(rows.shape[3])
        for u in range(own * abreast, wp.min((own + 1) * abreast, height)):
            to = (wp.int64(b) * wp.int64(height) + wp.int64(u)) * wp.int64(planes) * plane + wp.int64(WIDE)
            pixel = bottom - wp.int64(u) * wp.int64(width)
            copy_row(image, grad, face_index, b, pixel, 1, width, rows, to, plane, planes, spans, span + wp.int64(u))
    else:
        u = (own - row_tasks) * abreast
        count = wp.min(abreast, width - u)
        plane = wp.int64(columns.shape[3])
        to = (wp.int64(b) * wp.int64(width) + wp.int64(u)) * wp.int64(planes) * plane + wp.int64(WIDE)
        pixel = bottom + wp.int64(u)
        span += wp.int64(height + u)
        copy_columns(image, grad, face_index, b, pixel, count, height, columns, to, plane, planes, spans, span)


# On CUDA. Nothing is stored beside the lines: there, pixels are read one by one.
_COPY_PIXELS = f"""
#if defined(__CUDA_ARCH__)
    const int channels = grad.shape[1], height = face_index.shape[1], width = face_index.shape[2];
    const int planes = rows.shape[2], all = rows.shape[0] * height, half = grad.shape[3] < width ? 2 : 1;
    const wp::int64 area = (wp::int64)height * width, row_plane = rows.shape[3], column_plane = columns.shape[3];
    {PIXELS_OF_TASK}
    for (int row = first; row < last; ++row) {{
        const wp::int64 b = row / height;
        const int j = height - 1 - row % height;
        wp::vec_t<2, int>* span = spans.data + b * (height + width);
        for (int i = left; i < right; ++i) {{
            const wp::int64 pixel = b * channels * area + (row % height) * (wp::int64)width + i;
            const wp::int64 block = ((wp::int64)row / height * channels * (height / half) + row % height / half)
                * (width / half) + i / half;
            const float *value = image.data + pixel, *pull = grad.data + block;
            const float share = 1.0f / (float)(half * half);
            float* in_row = rows.data + (b * height + j) * planes * row_plane + {WIDE} + i;
            float* in_column = columns.data + (b * width + i) * planes * column_plane + {WIDE} + j;
            float sum = 0.0f;
            bool pulls = false;
            if (planes == 1) {{
                const float gain = -share * pull[0];
                const float covered = face_index.data[(wp::int64)row * width + i] >= 0 ? 1.0f : 0.0f;
                sum = gain > 0.0f ? gain * (1.0f - covered) : gain * covered;
                pulls = sum > 0.0f;
            }}
            for (int c = 0; c < planes - 1; ++c, value += area, pull += area / (half * half)) {{
                const float by = share * pull[0];
                if (half == 2) spread.data[pixel + c * area] = by;
                sum += value[0] * by;  // as in `_COPY`
                in_row[(c + 1) * row_plane] = in_column[(c + 1) * column_plane] = by;
                pulls |= by != 0.0f;
            }}
            in_row[0] = in_column[0] = sum;
            if (!pulls) continue;
            const int ends[4] = {{width - i, i + 1, height - j, j + 1}};
            int* const known[4] = {{&span[j][0], &span[j][1], &span[height + i][0], &span[height + i][1]}};
            for (int k = 0; k < 4; ++k)  // most pixels lie between others that pull
                if (*(volatile int*)known[k] < ends[k]) wp::atomic_max(known[k], ends[k]);
        }}
    }}
#endif
"""


@wp.func_native(_COPY_PIXELS)
def store_pixels(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    spread: wp.array4d(dtype=float),
    task: int,
    each: int,
):
    """Store the pixels of a task in their rows and columns, and extend the spans of these.

    If ``grad`` is that to blocks of 2 x 2 pixels, each pixel of an image has a quarter of it, which ``spread`` gets.
    """
    ...


@wp.kernel
def copy_pixels(
    first: int,
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    spread: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    queued: wp.array2d(dtype=int),
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    lanes: int,
    most: int,
    each: int,
):
    """Do the same as `copy_lines` on CUDA, where spans are 0 before, and put each visible face into a queue.

    See `enqueue_lines`. The first thread that finds a face puts it there, and sets its entry of ``queued``, 0 before.
    """
    task = first + wp.tid()
    store_pixels(image, grad, face_index, rows, columns, spans, spread, task, each)
    if queued.shape[0] == 0:
        return
    height = int(face_index.shape[1])
    width = int(face_index.shape[2])
    row, left, right = pixels_of_task(task, each, width)
    b = row // height
    for i in range(left, right):
        f = face_index[b, row % height, i]
        if f >= 0:
            if queued[b, f] == 0:  # most pixels end here
                if wp.atomic_cas(queued, b, f, 0, 1) == 0:
                    enqueue_lines(faces, b, f, height, width, queue, total, lanes, most)


@wp.func
def place(axis: int, u: int, v: int, height: int):
    """Convert pixel v of scan line u to (row from the top, column)."""
    if axis == 0:
        return height - 1 - u, v
    return height - 1 - v, u
