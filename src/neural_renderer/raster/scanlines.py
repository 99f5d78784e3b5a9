"""Scan lines of an image for the edge estimators: pixels stored side by side, and sums along them.

The loops are plain C++ over memory, because that is what compilers turn into vector instructions; Warp's own vectors
come out scalar.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

wp.set_module_options({"enable_backward": False})

# Pixels of a scan line that are handled at once; each stored line has as many zeros before and behind it.
WIDE = 16
PADDING = 2 * WIDE


_COPY_LINE = """
    for (int v = 0; v < length; ++v) {
        const float pull = grad.data[pixel + v * step], value = image.data[pixel + v * step];
        if (binary) {
            // A pixel beside the shape gains by being covered if its gradient is negative.
            lines.data[line + v] = (pull < 0.0f ? -pull : 0.0f) * (1.0f - value);
        } else {
            lines.data[line + v] = pull;
            lines.data[line + values + v] = value;
        }
    }
    int low = span[0], high = span[1];
    for (int v = 0; v < low; ++v) if (lines.data[line + v] != 0.0f) low = v;
    for (int v = length - 1; v > high; --v) if (lines.data[line + v] != 0.0f) high = v;
    return wp::vec_t<2, int>(low, high);
"""


@wp.func_native(_COPY_LINE)
def copy_line(
    grad: wp.array4d(dtype=float),
    image: wp.array4d(dtype=float),
    pixel: wp.int64,
    step: wp.int64,
    lines: wp.array4d(dtype=float),
    line: wp.int64,
    values: wp.int64,
    length: int,
    binary: int,
    span: wp.vec2i,
) -> wp.vec2i:
    """Copy one channel of a scan line from ``pixel`` on to ``line``, the image's ``values`` further; widen the span."""
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
    seen: wp.array2d(dtype=int),
    binary: int,
):
    """One scan line (rows first, then columns; counted from the bottom left): its pixels side by side, channel by
    channel, and the span outside which no pixel can pull an edge outward. Also marks the faces that are seen."""
    task = first + wp.tid()
    height = image.shape[1]
    width = image.shape[2]
    channels = image.shape[3]
    b = task // (height + width)
    line = task % (height + width)
    bottom = (wp.int64(b) * wp.int64(height) + wp.int64(height - 1)) * wp.int64(width)
    span = wp.vec2i(width, -1)
    if line < height:
        plane = wp.int64(width + PADDING)
        to = (wp.int64(b) * wp.int64(height) + wp.int64(line)) * wp.int64(rows.shape[2]) * plane + wp.int64(WIDE)
        for c in range(channels):
            pixel = (bottom - wp.int64(line) * wp.int64(width)) * wp.int64(channels) + wp.int64(c)
            here = to + wp.int64(c) * plane
            ahead = wp.int64(channels) * plane
            span = copy_line(grad, image, pixel, wp.int64(channels), rows, here, ahead, width, binary, span)
        for i in range(width):
            f = face_index[b, height - 1 - line, i]
            if f >= 0:
                seen[b, f] = 1
    else:
        u = line - height
        span = wp.vec2i(height, -1)
        plane = wp.int64(height + PADDING)
        to = (wp.int64(b) * wp.int64(width) + wp.int64(u)) * wp.int64(columns.shape[2]) * plane + wp.int64(WIDE)
        for c in range(channels):
            pixel = (bottom + wp.int64(u)) * wp.int64(channels) + wp.int64(c)
            here = to + wp.int64(c) * plane
            ahead = wp.int64(channels) * plane
            up = -wp.int64(channels) * wp.int64(width)
            span = copy_line(grad, image, pixel, up, columns, here, ahead, height, binary, span)
    spans[b, line] = span


_SWEEP = """
    float gain[16], sum_p[16], sum_q[16];
    for (int k = 0; k < 16; ++k) sum_p[k] = sum_q[k] = 0.0f;
    // The usual three channels are spelled out, so that their colours stay in registers.
    const float red = image.data[pixel], green = channels < 3 ? 0.0f : image.data[pixel + 1];
    const float blue = channels < 3 ? 0.0f : image.data[pixel + 2];
    const float slope = outward > 0 ? 1.0f : -1.0f;
    const float offset = outward > 0 ? distance : distance + 15.0f;
    for (int n = 0; n < count; n += 16) {
        const long long start = line + (outward > 0 ? n : -n - 15);
        const float* pull = lines.data + start;
        if (channels == 0) {
            for (int k = 0; k < 16; ++k) gain[k] = pull[k];
        } else {
            const float* value = pull + channels * plane;
            for (int k = 0; k < 16; ++k) gain[k] = (value[k] - red) * pull[k];
            if (channels >= 3)
                for (int k = 0; k < 16; ++k)
                    gain[k] += (value[plane + k] - green) * pull[plane + k]
                             + (value[2 * plane + k] - blue) * pull[2 * plane + k];
            for (int c = channels < 3 ? 1 : 3; c < channels; ++c) {
                const float shown = image.data[pixel + c];
                for (int k = 0; k < 16; ++k) gain[k] += (value[c * plane + k] - shown) * pull[c * plane + k];
            }
            for (int k = 0; k < 16; ++k) gain[k] = gain[k] > 0.0f ? gain[k] : 0.0f;
        }
        for (int k = 0; k < 16; ++k) {
            const float away = offset + (float)n + slope * (float)k;
            const float travel_p = reach * away + slack_p;
            const float travel_q = reach * away + slack_q;
            const float share = gain[k] / (travel_p * travel_q);
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


@wp.func_native(_SWEEP)
def sweep(
    lines: wp.array4d(dtype=float),
    line: wp.int64,
    plane: wp.int64,
    image: wp.array4d(dtype=float),
    pixel: wp.int64,
    channels: int,
    outward: int,
    count: int,
    distance: float,
    reach: float,
    slack_p: float,
    slack_q: float,
) -> wp.vec2:
    """Sum over pixels of a scan line what they gain by the colour at ``pixel``, over the corners' travel.

    line: where the first pixel lies in ``lines``, from which ``count`` pixels follow in the direction ``outward``;
    plane: from one channel to the next; channels: 0 where the stored values are the gains;
    distance: of the first pixel from the edge. Whatever is read beyond the count lies outside the line's span: no gain.
    """
    ...


_SHRINK = """
    float sum_p = 0.0f, sum_q = 0.0f;
    for (int n = 0; n < count; ++n) {
        const wp::int64 here = inner + n * step;
        if (face_index.data[here] != f) continue;
        float gain = 0.0f;
        for (int c = 0; c < channels; ++c)
            gain += (image.data[here * channels + c] - image.data[outer * channels + c]) * grad.data[here * channels +
            c];
        if (gain <= 0.0f) continue;
        const float away = distance + (float)n;
        const float travel_p = reach * away + slack_p, travel_q = reach * away + slack_q;
        const float share = gain / (travel_p * travel_q);
        sum_p += share * travel_q;
        sum_q += share * travel_p;
    }
    return wp::vec_t<2, float>(sum_p, sum_q);
"""


@wp.func_native(_SHRINK)
def shrink(
    face_index: wp.array3d(dtype=int),
    f: int,
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    inner: wp.int64,
    outer: wp.int64,
    step: wp.int64,
    count: int,
    channels: int,
    distance: float,
    reach: float,
    slack_p: float,
    slack_q: float,
) -> wp.vec2:
    """The same sum over the ``count`` pixels from ``inner`` on that show the face, by the colour at ``outer``.

    They are few, and not stored side by side; ``inner``, ``outer`` and ``step`` count pixels of the images.
    """
    ...


@wp.func
def place(axis: int, u: int, v: int, height: int):
    """Row (from the top) and column of the pixel v on scan line u."""
    if axis == 0:
        return height - 1 - u, v
    return height - 1 - v, u
