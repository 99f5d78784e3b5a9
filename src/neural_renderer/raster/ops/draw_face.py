"""Drawing the pixels of one face, for `coverage`: loops in plain C++, eight pixels at once on the CPU.

A pixel with edge functions e lies in a counter-clockwise face if none of them is negative; its depth is
(e . n) / (e . d). The formulas are the same on both devices, so that results agree to the bit.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# For each row of the face's box, the span between its crossings with the edges, widened by the rounding error. A box
# narrower than the pixels that are tested at once needs no span.
_ROWS = """
    const float x0 = v0[0], x1 = v1[0], x2 = v2[0], w = (float)width, h = (float)height;
    const float slope[3] = {v1[1] - v2[1], v2[1] - v0[1], v0[1] - v1[1]};
    for (int j = bottom; j <= top; ++j) {
        const float y = (float)(2 * j + 1 - height) / h;
        const float y0 = v0[1] - y, y1 = v1[1] - y, y2 = v2[1] - y;
        int first = left, last = right;
        if (right - left >= AT_ONCE) {
            float low = -2.0f, high = 2.0f;
            const float p[3] = {x1 * y2, x2 * y0, x0 * y1}, q[3] = {x2 * y1, x0 * y2, x1 * y0};
            for (int k = 0; k < 3; ++k) {
                const float steep = slope[k] < 0.0f ? -slope[k] : slope[k];
                if (steep > 1e-6f) {
                    const float at = (q[k] - p[k]) / slope[k];
                    const float size = (p[k] < 0.0f ? -p[k] : p[k]) + (q[k] < 0.0f ? -q[k] : q[k]);
                    const float doubt = 1e-6f * size / steep;
                    if (slope[k] > 0.0f) low = at - doubt > low ? at - doubt : low;
                    else high = at + doubt < high ? at + doubt : high;
                }
            }
            if (!(low <= high)) continue;
            const float begin = 0.5f * (w * low + w - 1.0f) - 0.01f, end = 0.5f * (w * high + w - 1.0f) + 0.01f;
            first = begin > (float)left ? (int)begin + 1 : left;
            last = end < (float)right ? (int)end : right;
        }
        const wp::int64 row = ((wp::int64)b * height + height - 1 - j) * width;
        PIXELS
    }
"""
_TEST = """
            const FLOATS e0 = (x1 - x) * y2 - y1 * (x2 - x);
            const FLOATS e1 = (x2 - x) * y0 - y2 * (x0 - x);
            const FLOATS e2 = (x0 - x) * y1 - y0 * (x1 - x);
            const FLOATS z = (e0 * n[0] + e1 * n[1] + e2 * n[2]) / (e0 * d[0] + e1 * d[1] + e2 * d[2]);
            const auto inside = (e0 >= 0.0f) & (e1 >= 0.0f) & (e2 >= 0.0f) & (z > NEAR);
"""
# The nearest face is visible; at equal depth, the one of lowest index.
_SINGLE = """
        for (int i = first + LANE; i <= last; i += LANES) {
            const float x = (float)(2 * i + 1 - width) / w;
            TEST
            SEE
        }
"""
_KEY = """
            // Positive floats have the order of their bits, so one minimum finds the nearest face of lowest index.
            const wp::int64 candidate = ((wp::int64)__float_as_int(z) << 32) | index;
            if (inside && z < far && candidate < key.data[row + i])
                atomicMin((long long*)key.data + row + i, (long long)candidate);
"""
_NEAREST = """
            float& depth = nearest.data[row + i];
            int& shown = face_index.data[row + i];
            if (inside & ((z < depth) | ((z == depth) & (index < shown)))) depth = z, shown = index;
"""
# The compiler's vector types. Most faces are too narrow for the loops that it vectorises by itself.
_EIGHT = """
        for (int i = first; i <= last; i += 8) {
            const int at = i < width - 8 ? i : width - 8;
            const floats x = ((float)(2 * at + 1 - width) + ahead) / w;
            TEST
            // Positive floats have the order of their bits. A minimum is stored directly; a selection would be stored
            // under a mask, which takes far longer.
            ints depth, shown;
            memcpy(&depth, nearest.data + row + at, sizeof(depth));
            memcpy(&shown, face_index.data + row + at, sizeof(shown));
            // Only pixels in the row's span. Far from a thin face, rounding errors decide the signs of edge functions.
            const ints spanned = (column >= first - at) & (column <= last - at);
            const ints bits = (inside & spanned) ? (ints)z : (shown & 0) + 0x7fffffff;
            const ints wins = (bits < depth) | ((bits == depth) & (shown > index));
            depth = __builtin_elementwise_min(bits, depth);
            shown = wins ? (shown & 0) + index : shown;
            memcpy(nearest.data + row + at, &depth, sizeof(depth));
            memcpy(face_index.data + row + at, &shown, sizeof(shown));
        }
"""


# The depth behind which each pixel is drawn, in place of `near`.
_FLOOR = "floor_depth.data[row + i]"
_FLOORS = "([&] { floats floor; memcpy(&floor, floor_depth.data + row + at, sizeof(floor)); return floor; })()"


def _loop(
    pixels: str, floats: str, at_once: int, see: str = "", lane: str = "0", lanes: str = "1", near: str = "near"
) -> str:
    pixels = pixels.replace("TEST", _TEST.replace("FLOATS", floats).replace("NEAR", near)).replace("SEE", see)
    pixels = pixels.replace("LANES", lanes).replace("LANE", lane)
    return _ROWS.replace("PIXELS", pixels).replace("AT_ONCE", str(at_once))


def _on_cuda(near: str = "near", lane: str = "0", lanes: str = "1") -> str:
    """Write the drawing of a face's pixels deeper than ``near`` into `_KEY`."""
    return f"""
#if defined(__CUDA_ARCH__)
    {_loop(_SINGLE, "float", 0, _KEY, lane, lanes, near)}
#endif
"""


def _on_cpu(near: str = "near", nears: str = "near") -> str:
    """Write the drawing of a face's pixels deeper than ``near``, one by one or, deeper than ``nears``, by eight."""
    return f"""
#if !defined(__CUDA_ARCH__)
    if (width < 8) {{ {_loop(_SINGLE, "float", 0, _NEAREST, near=near)} return; }}
    typedef float floats __attribute__((ext_vector_type(8)));
    typedef int ints __attribute__((ext_vector_type(8)));
    const floats ahead = {{0.0f, 2.0f, 4.0f, 6.0f, 8.0f, 10.0f, 12.0f, 14.0f}};
    const ints column = {{0, 1, 2, 3, 4, 5, 6, 7}};
    {_loop(_EIGHT, "floats", 8, near=nears)}
#endif
"""


@wp.func_native(_on_cuda(lane="lane", lanes="lanes"))
def draw_into_keys(
    key: wp.array3d(dtype=wp.int64),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    n: wp.vec3,
    d: wp.vec3,
    near: float,
    far: float,
    height: int,
    width: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
    lane: int,
    lanes: int,
):
    """Draw a face in front of the camera, concurrently with others, on CUDA: every n-th pixel of its box's rows."""
    ...


@wp.func_native(_on_cpu())
def draw_into_rows(
    nearest: wp.array3d(dtype=float),
    face_index: wp.array3d(dtype=int),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    n: wp.vec3,
    d: wp.vec3,
    near: float,
    height: int,
    width: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
):
    """Draw a face into its box on the CPU; ``nearest`` holds the least depth of each pixel so far, initially far."""
    ...


@wp.func_native(_on_cuda(near=_FLOOR))
def draw_behind_keys(
    key: wp.array3d(dtype=wp.int64),
    floor_depth: wp.array3d(dtype=float),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    n: wp.vec3,
    d: wp.vec3,
    far: float,
    height: int,
    width: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
):
    """Draw a face as `draw_into_keys`, where it is behind a depth that each pixel has."""
    ...


@wp.func_native(_on_cpu(_FLOOR, _FLOORS))
def draw_behind_rows(
    nearest: wp.array3d(dtype=float),
    face_index: wp.array3d(dtype=int),
    floor_depth: wp.array3d(dtype=float),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    n: wp.vec3,
    d: wp.vec3,
    height: int,
    width: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
):
    """Draw a face as `draw_into_rows`, where it is behind a depth that each pixel has."""
    ...


_EACH = """
    const wp::int64 start = ((wp::int64)b * face_index.shape[1] + first) * face_index.shape[2];
    const wp::int64 stop = ((wp::int64)b * face_index.shape[1] + last) * face_index.shape[2];
    for (wp::int64 i = start; i < stop; ++i) DO;
"""


@wp.func_native(_EACH.replace("DO", "nearest.data[i] = far, face_index.data[i] = -1"))
def clear_rows(
    nearest: wp.array3d(dtype=float), face_index: wp.array3d(dtype=int), b: int, first: int, last: int, far: float
):
    """Clear the rows [first, last) of an image: no face, at depth far."""
    ...


@wp.func_native(_EACH.replace("DO", "face_index.data[i] -= face_index.data[i] < count ? 0 : count"))
def turn_rows(face_index: wp.array3d(dtype=int), b: int, first: int, last: int, count: int):
    """Replace the indices of back sides, which start at ``count``, by those of their faces."""
    ...


_MARK = """
    int* own = visible.data + (wp::int64)b * visible.shape[1];
    const int none = visible.shape[1] - 1;
"""


# Written without a test: faces of neighbouring pixels differ too often for a predictable branch.
@wp.func_native(_MARK + _EACH.replace("DO", "own[face_index.data[i] < 0 ? none : face_index.data[i]] = 1"))
def mark_rows(face_index: wp.array3d(dtype=int), visible: wp.array2d(dtype=int), b: int, first: int, last: int):
    """Mark the faces that the rows [first, last) of an image show, as `visible_faces`."""
    ...
