"""The visible point of a face at a pixel, in plain C++: one source for every kernel that needs its weights.

``FACE`` declares two structs for native functions. ``Face``: ``set`` takes the corners of a face; ``at`` computes depth
and weights at a pixel; ``gather``, ``pull`` and ``give`` send the gradients of weights and depth to the corners.
``Eight`` does the same for eight neighbouring pixels at once, on the CPU, with bitwise equal weights. `over_rows`
builds a loop over the pixels of rows from them, and `over_face` a loop over the pixels of one face.

The code that Warp generates from the same formulas in Python takes about twice as long on the CPU.
"""

import re

from .geometry import HOMOGENEOUS, NARROWEST
from .layout import PIXELS_OF_TASK

# Least area, relative to c^2, of a face with reliable weights from the inverse matrix; c is its largest coordinate in
# pixels. The weights are sums of products up to 2 c^2, whose rounding errors add up to about 82 * 2^-24 c^2.
LEAST_AREA = 2.0**-17

# Vectors of eight numbers, on the CPU; ``load`` and ``store`` three channels of eight pixels that lie side by side.
VECTORS = """
#if !defined(__CUDA_ARCH__)
struct Vectors {
    typedef float floats __attribute__((ext_vector_type(8)));
    typedef int ints __attribute__((ext_vector_type(8)));

    static ints ahead() { return ints{0, 1, 2, 3, 4, 5, 6, 7}; }
    static floats none() { return floats(0.0f); }
    static unsigned bits(ints lanes) {  // of a mask: bit n is lane n
        typedef bool bools __attribute__((ext_vector_type(8)));
        const bools each = __builtin_convertvector(lanes, bools);
        unsigned char result;
        memcpy(&result, &each, sizeof(result));
        return result;
    }
    static float sum(floats v) { return v[0] + v[1] + v[2] + v[3] + (v[4] + v[5] + v[6] + v[7]); }

    static void load(const float* from, floats* to) {
        floats u, v, w;
        memcpy(&u, from, sizeof(u)), memcpy(&v, from + 8, sizeof(v)), memcpy(&w, from + 16, sizeof(w));
        const floats a = __builtin_shufflevector(u, v, 0, 3, 6, 9, 12, 15, -1, -1);
        const floats b = __builtin_shufflevector(u, v, 1, 4, 7, 10, 13, -1, -1, -1);
        const floats c = __builtin_shufflevector(u, v, 2, 5, 8, 11, 14, -1, -1, -1);
        to[0] = __builtin_shufflevector(a, w, 0, 1, 2, 3, 4, 5, 10, 13);
        to[1] = __builtin_shufflevector(b, w, 0, 1, 2, 3, 4, 8, 11, 14);
        to[2] = __builtin_shufflevector(c, w, 0, 1, 2, 3, 4, 9, 12, 15);
    }
    static void store(float* to, floats a, floats b, floats c) {
        floats u = __builtin_shufflevector(a, b, 0, 8, -1, 1, 9, -1, 2, 10);
        floats v = __builtin_shufflevector(a, b, -1, 3, 11, -1, 4, 12, -1, 5);
        floats w = __builtin_shufflevector(a, b, 13, -1, 6, 14, -1, 7, 15, -1);
        u = __builtin_shufflevector(u, c, 0, 1, 8, 3, 4, 9, 6, 7);
        v = __builtin_shufflevector(v, c, 10, 1, 2, 11, 4, 5, 12, 7);
        w = __builtin_shufflevector(w, c, 0, 13, 2, 3, 14, 5, 6, 15);
        memcpy(to, &u, sizeof(u)), memcpy(to + 8, &v, sizeof(v)), memcpy(to + 16, &w, sizeof(w));
    }
};
#endif
"""

FACE = f"""
{VECTORS}
struct Face {{
    typedef wp::vec_t<3, float> vec3;
    vec3 v[3];
    float matrix[9], inverse[3], dx[3], dy[3], to[9];
    bool front, known;  // in front of the camera; weights known by the matrix
    int perspective, height, width;

    static CUDA_CALLABLE float centre(int i, int size) {{ return (float)(2 * i + 1 - size) / (float)size; }}
    static CUDA_CALLABLE float larger(float a, float b) {{ return a > b ? a : b; }}
    // Rare cases. Inside the loops they would take registers, so on the CPU they are not inlined.
    #if defined(__CUDA_ARCH__)
    #define RARE CUDA_CALLABLE
    #else
    #define RARE __attribute__((noinline))
    #endif
    static RARE wp::vec_t<3, double> homogeneous(
        vec3 v0, vec3 v1, vec3 v2, float x, float y) {{ {HOMOGENEOUS} }}
    // The weights by the edge functions of `coverage`. At the pixels it drew, they have one sign and are not all 0.
    static RARE vec3 by_edges(vec3 v0, vec3 v1, vec3 v2, float x, float y) {{
        const vec3 w((v1[0] - x) * (v2[1] - y) - (v1[1] - y) * (v2[0] - x),
                     (v2[0] - x) * (v0[1] - y) - (v2[1] - y) * (v0[0] - x),
                     (v0[0] - x) * (v1[1] - y) - (v0[1] - y) * (v1[0] - x));
        const float whole = w[0] + w[1] + w[2], third = 1.0f / 3.0f;
        // Divided at once, because their products with 1 / z could overflow or underflow.
        return whole == 0.0f ? vec3(third, third, third) : vec3(w[0] / whole, w[1] / whole, w[2] / whole);
    }}

    // The matrix maps a pixel (column, row from the bottom, 1) to its weights. It is 0 if edge functions are needed.
    // The first packages computed weights by this inverse, and existing results contain its rounding errors: about 1e-4
    // of a weight for faces far smaller than a pixel.
    CUDA_CALLABLE void set(const vec3* corners, int in_perspective, int rows, int columns) {{
        perspective = in_perspective, height = rows, width = columns;
        float x[3], y[3], far = 0.0f;
        for (int k = 0; k < 3; ++k) {{
            v[k] = corners[k];
            x[k] = 0.5f * ((float)width * v[k][0] + (float)(width - 1));
            y[k] = 0.5f * ((float)height * v[k][1] + (float)(height - 1));
            far = larger(far, larger(fabsf(x[k]), fabsf(y[k])));
            inverse[k] = perspective ? 1.0f / v[k][2] : 1.0f;
        }}
        // A visible face lies in front of the camera or crosses its plane.
        front = !perspective | ((v[0][2] > 0.0f) & (v[1][2] > 0.0f) & (v[2][2] > 0.0f));
        const float area = x[2] * (y[0] - y[1]) + x[0] * (y[1] - y[2]) + x[1] * (y[2] - y[0]);
        known = fabsf(area) > {LEAST_AREA!r}f * far * far;
        const float part = known ? 1.0f / area : 0.0f;
        for (int k = 0; k < 3; ++k) {{
            const int m = (k + 1) % 3, n = (k + 2) % 3;
            matrix[3 * k] = (y[m] - y[n]) * part;
            matrix[3 * k + 1] = (x[n] - x[m]) * part;
            matrix[3 * k + 2] = (x[m] * y[n] - x[n] * y[m]) * part;
        }}
    }}

    // Depth and perspective-correct weights at pixel i of row j from the bottom. Screen-space weights are w / whole.
    CUDA_CALLABLE float at(int i, int j, vec3& weights, vec3& w, float& whole) const {{
        const float px = (float)i, py = (float)j;
        if (!front) {{
            const wp::vec_t<3, double> a = homogeneous(v[0], v[1], v[2], centre(i, width), centre(j, height));
            const double sum = a[0] + a[1] + a[2];
            for (int k = 0; k < 3; ++k) weights[k] = (float)(a[k] / sum), w[k] = (float)(a[k] * (double)v[k][2]);
            whole = 1.0f;
            return (float)(1.0 / sum);
        }}
        for (int k = 0; k < 3; ++k) {{
            const float share = matrix[3 * k] * px + matrix[3 * k + 1] * py + matrix[3 * k + 2];
            w[k] = share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
        }}
        whole = w[0] + w[1] + w[2];
        if (whole == 0.0f) {{
            w = by_edges(v[0], v[1], v[2], centre(i, width), centre(j, height));
            whole = w[0] + w[1] + w[2];
        }}
        if (perspective) {{
            for (int k = 0; k < 3; ++k) weights[k] = w[k] * inverse[k];
            const float near = 1.0f / (weights[0] + weights[1] + weights[2]);
            for (int k = 0; k < 3; ++k) weights[k] *= near;
            return whole * near;
        }}
        const float part = 1.0f / whole;
        for (int k = 0; k < 3; ++k) weights[k] = w[k] * part;
        return weights[0] * v[0][2] + weights[1] * v[1][2] + weights[2] * v[2][2];
    }}

    // Start to gather gradients. dx and dy are the slopes of the weights on the screen. They are set to 0 if a weight
    // changes by 1 over less than four roundings of a coordinate near 1: then they are not known.
    CUDA_CALLABLE void gather() {{
        const float area = (v[1][0] - v[0][0]) * (v[2][1] - v[0][1]) - (v[1][1] - v[0][1]) * (v[2][0] - v[0][0]);
        float longest = 0.0f;
        for (int k = 0; k < 3; ++k) {{
            const vec3 &a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
            dx[k] = a[1] - b[1], dy[k] = b[0] - a[0];
            longest = larger(longest, larger(fabsf(dx[k]), fabsf(dy[k])));
        }}
        const float part = fabsf(area) > {NARROWEST!r}f * longest ? 1.0f / area : 0.0f;
        for (int k = 0; k < 3; ++k) dx[k] *= part, dy[k] *= part;
        for (int k = 0; k < 9; ++k) to[k] = 0.0f;
    }}

    // At a fixed pixel, moving corner m by s on the screen changes the weight w_k by -w_m grad(w_k) . s. In
    // perspective, depth and the weights in space are computed from w_k / z_k, whose sum is 1 / depth.
    CUDA_CALLABLE void pull(vec3 to_weights, float to_depth, vec3 weights, vec3 w, float whole, float z) {{
        const float part = 1.0f / whole;
        float right = 0.0f, up = 0.0f, g[3];
        const float same = wp::dot(to_weights, weights) + z * to_depth;
        for (int k = 0; k < 3; ++k) {{
            g[k] = perspective ? z * (to_weights[k] - same) * inverse[k] : to_weights[k] + to_depth * v[k][2];
            right += g[k] * dx[k], up += g[k] * dy[k];
        }}
        for (int k = 0; k < 3; ++k) {{
            const float share = w[k] * part;
            to[3 * k] -= right * share;
            to[3 * k + 1] -= up * share;
            to[3 * k + 2] += share * (perspective ? -g[k] * inverse[k] : to_depth);
        }}
    }}

    // Add the sums to the gradients of the face's corners; ``alone``: no other task writes them.
    CUDA_CALLABLE void give(vec3* corners, bool alone) const {{
        for (int k = 0; k < 3; ++k) {{
            const vec3 part(to[3 * k], to[3 * k + 1], to[3 * k + 2]);
            if (alone) corners[k] = part;
            else wp::atomic_add(corners + k, part);
        }}
    }}
}};
#if !defined(__CUDA_ARCH__)
struct Eight : Vectors {{
    floats w[3], weights[3], part, z;  // as in Face; part is 1 / whole
    floats to[9];

    static bool can(const Face& face) {{ return face.front & face.known; }}

    // Eight pixels from i on, in row j. Pixels with a result other than 0 need the edge functions: use Face for them.
    ints at(const Face& face, int i, int j) {{
        const floats x = __builtin_convertvector(ahead() + i, floats);
        for (int k = 0; k < 3; ++k) {{
            const float along = face.matrix[3 * k + 1] * (float)j;
            const floats share = x * face.matrix[3 * k] + along + face.matrix[3 * k + 2];
            w[k] = share < 0.0f ? none() : share > 1.0f ? none() + 1.0f : share;
        }}
        floats whole = w[0] + w[1] + w[2];
        const ints lost = whole == 0.0f;
        // Avoid 0 / 0 beside the face, too: NaN times 0 is NaN.
        w[0] = lost ? none() + 1.0f : w[0], whole = lost ? none() + 1.0f : whole;
        part = 1.0f / whole;
        if (face.perspective) {{
            for (int k = 0; k < 3; ++k) weights[k] = w[k] * face.inverse[k];
            const floats near = 1.0f / (weights[0] + weights[1] + weights[2]);
            for (int k = 0; k < 3; ++k) weights[k] *= near;
            z = whole * near;
        }} else {{
            for (int k = 0; k < 3; ++k) weights[k] = w[k] * part;
            z = weights[0] * face.v[0][2] + weights[1] * face.v[1][2] + weights[2] * face.v[2][2];
        }}
        return lost;
    }}

    void gather() {{
        for (int k = 0; k < 9; ++k) to[k] = none();
    }}
    // Sum over the pixels that are ``here``. The gradients of the others must be finite.
    void pull(const Face& face, const floats* to_weights, floats to_depth, ints here) {{
        const floats same =
            to_weights[0] * weights[0] + to_weights[1] * weights[1] + to_weights[2] * weights[2] + z * to_depth;
        floats right = none(), up = none(), g[3];
        for (int k = 0; k < 3; ++k) {{
            g[k] = face.perspective ? z * (to_weights[k] - same) * face.inverse[k]
                                    : to_weights[k] + to_depth * face.v[k][2];
            right += g[k] * face.dx[k], up += g[k] * face.dy[k];
        }}
        for (int k = 0; k < 3; ++k) {{
            const floats share = here ? w[k] * part : none();
            to[3 * k] -= right * share;
            to[3 * k + 1] -= up * share;
            to[3 * k + 2] += share * (face.perspective ? -g[k] * face.inverse[k] : to_depth);
        }}
    }}
    void give(Face& face) const {{
        for (int k = 0; k < 9; ++k) face.to[k] = sum(to[k]);
    }}
}};
#endif
"""

_ROWS = """
    #if defined(__CUDA_ARCH__)
    enum { KEPT = 1 };
    #else
    enum { KEPT = 128 };  // neighbouring rows show the same faces
    #endif
    const int height = face_index.shape[1], width = face_index.shape[2];
    const wp::int64 count = faces.shape[1];
    Face kept[KEPT];
    wp::int64 held[KEPT];
    for (int k = 0; k < KEPT; ++k) held[k] = -1;
    BEGIN
    const int all = face_index.shape[0] * height;
    PIXELS_OF_TASK
    for (int row = first; row < last; ++row) {
        const int b = row / height, j = height - 1 - row % height;
        const int* shown = face_index.data + (wp::int64)row * width;
        for (int i = left; i < right; ++i) {
            const wp::int64 pixel = (wp::int64)row * width + i;
            const int f = shown[i];
            if (f < 0) {  // most pixels of most images, so several are skipped at once
                int empty = 1;
                #if !defined(__CUDA_ARCH__)
                for (int four[4]; i + empty + 4 <= right; empty += 4) {
                    memcpy(four, shown + i + empty, sizeof(four));
                    if ((four[0] & four[1] & four[2] & four[3]) >= 0) break;
                }
                #endif
                while (i + empty < right && shown[i + empty] < 0) ++empty;
                EMPTY
                i += empty - 1;
                continue;
            }
            const wp::int64 own = b * count + f;
            const int slot = f % KEPT;
            Face& face = kept[slot];
            if (held[slot] != own) {
                face.set(faces.data + own * 3, perspective, height, width);
                held[slot] = own;
                FRESH
            }
            #if !defined(__CUDA_ARCH__)
            if (Eight::can(face)) {  // the pixels up to the next face, at most eight
                int run = 1;
                while (run < 8 && i + run < right && shown[i + run] == f) ++run;
                Eight eight;
                if (__builtin_reduce_or(eight.at(face, i, j) & (Eight::ahead() < run)) == 0) {
                    RUN
                    i += run - 1;
                    continue;
                }
            }
            #endif
            wp::vec_t<3, float> weights, on_screen;
            float whole;
            const float z = face.at(i, j, weights, on_screen, whole);
            SHOWN
        }
    }
"""

_BOX = """
    const int height = face_index.shape[1], width = face_index.shape[2];
    const wp::int64 count = faces.shape[1];
    Face face;
    face.set(faces.data + (b * count + f) * 3, perspective, height, width);
    if (faces_too) face.gather();
    BEGIN
    bool done = false;
    #if !defined(__CUDA_ARCH__)
    if (Eight::can(face) && width >= 8 && FITS) {
        Eight eight;
        eight.gather();
        done = true;
        EIGHT_BEGIN
        for (int j = bottom; j <= top && done; ++j) {
            const wp::int64 row = ((wp::int64)b * height + height - 1 - j) * width;
            for (int i = left; i <= right && done; i += 8) {
                const int at = i < width - 8 ? i : width - 8;
                Eight::ints shown;
                memcpy(&shown, face_index.data + row + at, sizeof(shown));
                const Eight::ints here = (shown == f) & (Eight::ahead() >= i - at);
                if (__builtin_reduce_or(here) == 0) continue;
                done = __builtin_reduce_or(eight.at(face, at, j) & here) == 0;
                if (!done) continue;  // all pixels again, one by one
                EIGHT
            }
        }
        if (done) {
            EIGHT_END
            if (faces_too) { GIVE }
        }
    }
    #endif
    for (int j = bottom; j <= top && !done; ++j) {
        const wp::int64 row = ((wp::int64)b * height + height - 1 - j) * width;
        for (int i = left; i <= right; ++i) {
            if (face_index.data[row + i] != f) continue;
            wp::vec_t<3, float> weights, on_screen;
            float whole;
            const float z = face.at(i, j, weights, on_screen, whole);
            ONE
        }
    }
    if (faces_too) face.give(to_faces.data + (b * count + f) * 3, alone);
    END
"""


def over_rows(shown: str, run: str, empty: str, begin: str = "", fresh: str = "", structs: str = "") -> str:
    """Build the body of a native function over the pixels of a ``task`` of ``each`` rows; see `pixel_tasks`.

    Args:
        shown: Statements for a pixel that shows a face, with row, pixel, i, b, f, own (f counted over all images),
            face, slot, weights and z.
        run: The same for ``run`` consecutive pixels of one face, at most 8, with ``eight`` in place of weights and z.
            Results for pixels after the run, in the same row, may be written: they are computed later.
        empty: Statements for ``empty`` consecutive pixels without a face, from i and pixel on.
        begin: Statements before the loop.
        fresh: Statements for a face that is not among the KEPT ones, with its ``slot``.
        structs: Declarations that may need those of `FACE`.

    Returns:
        C++ statements.
    """
    return (
        FACE
        + structs
        + fill(_ROWS, PIXELS_OF_TASK=PIXELS_OF_TASK, BEGIN=begin, EMPTY=empty, FRESH=fresh, SHOWN=shown, RUN=run)
    )


def over_face(
    one: str,
    eight: str,
    begin: str = "",
    end: str = "",
    eight_begin: str = "",
    eight_end: str = "",
    give: str = "eight.give(face);",
    fits: str = "true",
    structs: str = "",
) -> str:
    """Build the body of a native function that sums over the pixels of a face f of image b in a box.

    The function has the arguments faces, face_index, perspective, b, f, the box (left, right, bottom, top), ``alone``
    (no other task writes what this one does), ``faces_too`` and ``to_faces``.

    Args:
        one: Statements for a pixel i, row + i in memory, with face, weights, on_screen, whole and z.
        eight: The same for eight pixels from ``at`` on, with ``eight``; ``here`` marks the lanes that show the face.
        begin, end: Statements before and after.
        eight_begin, eight_end: Statements before and after pixels are taken in eights. If that fails half-way, all
            pixels are taken one by one, and ``eight_end`` is left out.
        give: Statements that set ``face.to`` after eights, where they did not call ``eight.pull``.
        fits: Condition for taking pixels in eights.
        structs: Declarations that may need those of `FACE`.

    Returns:
        C++ statements.
    """
    eights = {"EIGHT_BEGIN": eight_begin, "EIGHT": eight, "EIGHT_END": eight_end, "GIVE": give, "FITS": fits}
    return FACE + structs + fill(_BOX, BEGIN=begin, ONE=one, END=end, **eights)


def fill(code: str, **parts: str) -> str:
    """Replace the words that stand alone in C++ code by statements."""
    return re.sub(r"\b(" + "|".join(parts) + r")\b", lambda found: parts[found[0]], code)
