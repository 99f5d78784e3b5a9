"""Scan lines of an image for the edge estimators: pixels stored side by side, and sums along them.

The loops are plain C++ over memory, because that is what compilers turn into vector instructions; Warp's own vectors
come out scalar.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import math

import torch
import warp as wp
from torch import Tensor

wp.set_module_options({"enable_backward": False})

# Pixels of a scan line that are handled at once; before each stored line, and behind the last, there are as many zeros.
WIDE = 16


def empty_lines(batch: int, lines: int, length: int, planes: int, device: torch.device) -> Tensor:
    """Room for scan lines: [batch, lines, planes, WIDE + length]; what is stored of a pixel is a plane apart.

    First the sum over channels of value times gradient, then the gradient of each channel, of which the image may have
    more than are stored. Of a silhouette, one number: what a pixel beside the shape gains by being covered, or, less
    than zero, what one of the shape gains by being uncovered.
    """
    shape = (batch, lines, planes, WIDE + length)
    room = torch.empty(math.prod(shape) + WIDE, dtype=torch.float32, device=device)
    room[-WIDE:] = 0
    return room[:-WIDE].view(shape)


_COPY = """
    #pragma clang fp contract(fast)
    const wp::int64 area = (wp::int64)image.shape[2] * image.shape[3], next = planes * plane;
    const int channels = image.shape[1];
    float* stored = lines.data + line;
    for (int k = 0; k < count * planes; ++k)
        for (int i = 1; i <= 16; ++i) stored[k * plane - i] = 0.0f;
    const float *value = image.data + b * channels * area + pixel, *pull = grad.data + b * channels * area + pixel;
    if (planes == 1) {
        EACH {
            const float gain = -pull[from];
            stored[to] = gain > 0.0f ? gain * (1.0f - value[from]) : gain * value[from];
        }
    } else {
        EACH stored[to] = 0.0f;
        for (int c = 0; c < planes - 1; ++c, value += area, pull += area) {
            // Summed as `_SUM` does it: a pixel of the very colour it would change to must gain nothing at all.
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
        spans.data[span + k] = wp::vec_t<2, int>(low, high);
    }
"""


@wp.func_native(_COPY.replace("EACH", "for (int from = 0, to = 0; to < length; ++from, ++to)"))
def copy_row(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
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
    _COPY.replace(
        "EACH",
        "for (int v = 0; v < length; ++v) for (wp::int64 k = 0, from = -(wp::int64)v * image.shape[3], to = v;"
        " k < count; ++k, ++from, to += next)",
    )
)
def copy_columns(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
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
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    abreast: int,
):
    """Neighbouring rows, or columns, as many as are read ``abreast``; all are counted from the bottom left.

    A line's span is from the first to the last pixel that can pull an edge outward.
    """
    task = first + wp.tid()
    height = image.shape[2]
    width = image.shape[3]
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
            copy_row(image, grad, b, pixel, 1, width, rows, to, plane, planes, spans, span + wp.int64(u))
    else:
        u = (own - row_tasks) * abreast
        count = wp.min(abreast, width - u)
        plane = wp.int64(columns.shape[3])
        to = (wp.int64(b) * wp.int64(width) + wp.int64(u)) * wp.int64(planes) * plane + wp.int64(WIDE)
        pixel = bottom + wp.int64(u)
        span += wp.int64(height + u)
        copy_columns(image, grad, b, pixel, count, height, columns, to, plane, planes, spans, span)


# The sum over ``count`` pixels of a scan line, from ``line`` on in the direction ``way``, of what they gain by the
# colour at ``pixel``, over the travel of an edge's two corners: for each corner reach * distance + its slack.
# What is read beyond the count must be zero, or not be kept. Operands may be fused: an exact zero stays one.
_SUM = """
    #pragma clang fp contract(fast)
    float gain[16], lost[16], sum_p[16], sum_q[16];
    for (int k = 0; k < 16; ++k) sum_p[k] = sum_q[k] = 0.0f;
    // The usual three channels are spelled out, so that their colours stay in registers.
    const wp::int64 area = (wp::int64)image.shape[2] * image.shape[3];
    const float red = image.data[pixel], green = channels < 3 ? 0.0f : image.data[pixel + area];
    const float blue = channels < 3 ? 0.0f : image.data[pixel + 2 * area];
    const float slope = way > 0 ? 1.0f : -1.0f;
    const float offset = way > 0 ? distance : distance + 15.0f;
    for (int n = 0; n < count; n += 16) {
        const wp::int64 start = line + (way > 0 ? n : -n - 15);
        const float* stored = lines.data + start;
        BLOCK
        if (channels > 0) {
            const float* pull = stored + plane;
            for (int k = 0; k < 16; ++k) lost[k] = red * pull[k];
            if (channels >= 3) {
                for (int k = 0; k < 16; ++k) lost[k] += green * pull[plane + k];
                for (int k = 0; k < 16; ++k) lost[k] += blue * pull[2 * plane + k];
            }
            for (int c = channels < 3 ? 1 : 3; c < channels; ++c) {
                const float color = image.data[pixel + c * area];
                for (int k = 0; k < 16; ++k) lost[k] += color * pull[c * plane + k];
            }
            for (int k = 0; k < 16; ++k) gain[k] -= lost[k];
        }
        for (int k = 0; k < 16; ++k) {
            const float away = offset + (float)n + slope * (float)k;
            const float travel_p = reach * away + slack_p;
            const float travel_q = reach * away + slack_q;
            const float share = (KEEP ? gain[k] : 0.0f) / (travel_p * travel_q);
            sum_p[k] += share * travel_q;
            sum_q[k] += share * travel_p;
        }
    }
    for (int half = 8; half > 0; half /= 2)
        for (int k = 0; k < half; ++k) {
            sum_p[k] += sum_p[k + half];
            sum_q[k] += sum_q[k + half];
        }
    return wp::vec_t<2, float>(sum_p[0], sum_q[0]);
"""


@wp.func_native(
    _SUM.replace("BLOCK", "for (int k = 0; k < 16; ++k) gain[k] = stored[k];").replace("KEEP", "gain[k] > 0.0f")
)
def sweep(
    lines: wp.array4d(dtype=float),
    line: wp.int64,
    plane: wp.int64,
    image: wp.array4d(dtype=float),
    pixel: wp.int64,
    channels: int,
    way: int,
    count: int,
    distance: float,
    reach: float,
    slack_p: float,
    slack_q: float,
) -> wp.vec2:
    """Outward, to the end of the line's span. channels: 0 where what is stored at ``line`` are the gains themselves;
    distance: of the first pixel from the edge."""
    ...


_SHOWN = """
        const int* pixels = face_index.data + shown;
        int face[16];
        for (int k = 0; k < 16; ++k) {
            const int here = way > 0 ? n + k : n + 15 - k;
            face[k] = pixels[here < count ? here * step : 0];
        }
        for (int k = 0; k < 16; ++k) gain[k] = channels > 0 ? stored[k] : -stored[k];
"""
_IS_SHOWN = "gain[k] > 0.0f && face[k] == f && (way > 0 ? n + k : n + 15 - k) < count"


@wp.func_native(_SUM.replace("BLOCK", _SHOWN).replace("KEEP", _IS_SHOWN))
def shrink(
    lines: wp.array4d(dtype=float),
    line: wp.int64,
    plane: wp.int64,
    image: wp.array4d(dtype=float),
    pixel: wp.int64,
    channels: int,
    way: int,
    count: int,
    distance: float,
    reach: float,
    slack_p: float,
    slack_q: float,
    f: int,
    face_index: wp.array3d(dtype=int),
    shown: wp.int64,
    step: int,
) -> wp.vec2:
    """Inward, over the pixels that show the face ``f`` by ``face_index`` from ``shown`` on, ``step`` apart."""
    ...


@wp.func
def place(axis: int, u: int, v: int, height: int):
    """Row (from the top) and column of the pixel v on scan line u."""
    if axis == 0:
        return height - 1 - u, v
    return height - 1 - v, u
