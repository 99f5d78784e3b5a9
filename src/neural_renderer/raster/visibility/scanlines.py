"""Scan lines of an image for the edge estimators: pixels stored side by side, and sums along them.

The loops are plain C++ over memory, because compilers turn those into vector instructions. Warp's own vectors compile
to scalar code.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import math

import torch
import warp as wp
from torch import Tensor

wp.set_module_options({"enable_backward": False})

# Pixels of a scan line that are processed at once. As many zeros precede each stored line and follow the last one.
WIDE = 16


def empty_lines(batch: int, lines: int, length: int, planes: int, device: torch.device) -> Tensor:
    """Allocate scan lines, [batch, lines, planes, WIDE + length] float32.

    Plane 0 holds the sum over channels of value times gradient. The other planes hold the gradients of the first
    channels. A silhouette has one plane, the gains: if covering the pixel lowers the loss, the decrease; if uncovering
    it does, minus the decrease.
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
    """Copy ``abreast`` neighbouring rows or columns of an image. Lines and pixels count from the bottom left.

    The span of a line reaches from the first to the last pixel that can pull an edge outward.
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


# Sums over the pixels of a stored scan line. The gain of a pixel is the decrease of the loss if an edge moves to the
# pixel and changes its colour. Each of the edge's two corners gets the sum of gain / (reach * distance + slack), times
# the corner's share. The compiler may fuse operations as in `_COPY`: an exact zero stays zero.
SCAN_LINE = """
struct ScanLine {
    #if defined(__CUDA_ARCH__)
    typedef float floats;
    enum { AT_ONCE = 1 };
    static CUDA_CALLABLE floats load(const float* from) { return *from; }
    static CUDA_CALLABLE floats ahead() { return 0.0f; }
    static CUDA_CALLABLE float total(floats v) { return v; }
    #else
    typedef float floats __attribute__((ext_vector_type(16)));
    typedef int ints __attribute__((ext_vector_type(16)));
    enum { AT_ONCE = 16, FEW = 8 };
    static floats load(const float* from) {
        floats all;
        memcpy(&all, from, sizeof(all));
        return all;
    }
    static floats ahead() {
        return floats{0.f, 1.f, 2.f, 3.f, 4.f, 5.f, 6.f, 7.f, 8.f, 9.f, 10.f, 11.f, 12.f, 13.f, 14.f, 15.f};
    }
    static float total(floats v) {
        const auto eight = v.lo + v.hi;
        const auto four = eight.lo + eight.hi;
        return four[0] + four[2] + (four[1] + four[3]);
    }
    #endif
    const float* stored;  // first pixel of the line in plane 0; the gradients of the channels follow, a plane each
    wp::int64 plane, area;
    int channels;  // 0 for a silhouette: the line stores its gains
    const float* color;  // the new colour's first channel; the next one is an area further
    float reach, share_p, share_q, slack_p, slack_q;
    floats to_p, to_q;  // sums over AT_ONCE pixels at a time
    float also_to_p, also_to_q;  // sums over single pixels

    // The usual three channels are written out, so that their colours stay in registers.
    CUDA_CALLABLE floats loss(const float* pull, float red, float green, float blue) const {
        #pragma clang fp contract(fast)
        floats lost = red * load(pull);
        if (channels >= 3) {
            lost += green * load(pull + plane);
            lost += blue * load(pull + 2 * plane);
        }
        for (int c = channels < 3 ? 1 : 3; c < channels; ++c) lost += color[c * area] * load(pull + c * plane);
        return lost;
    }

    // Sum over ``count`` pixels from ``begin`` in the direction ``way``; the first is at ``distance`` from the edge.
    // Beyond these pixels, the line must hold zeros.
    CUDA_CALLABLE void outward(int begin, int way, int count, float distance) {
        #pragma clang fp contract(fast)
        const float red = color[0], green = channels < 3 ? 0.0f : color[area];
        const float blue = channels < 3 ? 0.0f : color[2 * area];
        const floats none = 0.0f, start = distance + (way > 0 ? ahead() : (float)(AT_ONCE - 1) - ahead());
        const float* at = stored + begin - (way > 0 ? 0 : AT_ONCE - 1);
        floats sum_p = none, sum_q = none;
        for (int n = 0; n < count; n += AT_ONCE, at += way * AT_ONCE) {
            floats gain = load(at);
            if (channels > 0) gain -= loss(at + plane, red, green, blue);
            ADD
        }
        to_p += share_p * sum_p, to_q += share_q * sum_q;
    }

    // Sum over the pixels that show the face f. ``shown`` points to the first pixel's face; the next is ``step`` away.
    CUDA_CALLABLE void inward(int begin, int way, int count, float distance, int f, const int* shown, int step) {
        #pragma clang fp contract(fast)
        #if !defined(__CUDA_ARCH__)
        if (count > FEW) return inward_by_many(begin, way, count, distance, f, shown, step);
        #endif
        float sum_p = 0.0f, sum_q = 0.0f;
        const float* at = stored + begin;
        for (int n = 0; n < count; ++n, at += way, shown += step) {
            if (*shown != f) continue;
            float gain = channels > 0 ? at[0] : -at[0];
            if (channels > 0) {
                float lost = color[0] * at[plane];
                for (int c = 1; c < channels; ++c) lost += color[c * area] * at[(c + 1) * plane];
                gain -= lost;
            }
            typedef float floats;
            const float start = distance, none = 0.0f;
            ADD
        }
        also_to_p += share_p * sum_p, also_to_q += share_q * sum_q;
    }

    #if !defined(__CUDA_ARCH__)
    void inward_by_many(int begin, int way, int count, float distance, int f, const int* shown, int step) {
        #pragma clang fp contract(fast)
        const float red = color[0], green = channels < 3 ? 0.0f : color[area];
        const float blue = channels < 3 ? 0.0f : color[2 * area];
        const floats none = 0.0f, start = distance + (way > 0 ? ahead() : (float)(AT_ONCE - 1) - ahead());
        const float* at = stored + begin - (way > 0 ? 0 : AT_ONCE - 1);
        floats sum_p = none, sum_q = none;
        for (int n = 0; n < count; n += AT_ONCE, at += way * AT_ONCE) {
            ints here;
            for (int k = 0; k < AT_ONCE; ++k) {
                const int away = way > 0 ? n + k : n + AT_ONCE - 1 - k;
                here[k] = away < count && shown[away < count ? away * step : 0] == f ? -1 : 0;
            }
            floats gain = channels > 0 ? load(at) - loss(at + plane, red, green, blue) : -load(at);
            gain = here ? gain : none;
            ADD
        }
        to_p += share_p * sum_p, to_q += share_q * sum_q;
    }
    #endif
};
""".replace(
    "ADD",
    """const floats away = start + (float)n;
            const floats travel_p = reach * away + slack_p, travel_q = reach * away + slack_q;
            const floats part = (gain > 0.0f ? gain : none) / (travel_p * travel_q);
            sum_p += part * travel_q, sum_q += part * travel_p;""",
)


@wp.func
def place(axis: int, u: int, v: int, height: int):
    """Row (from the top) and column of the pixel v on scan line u."""
    if axis == 0:
        return height - 1 - u, v
    return height - 1 - v, u
