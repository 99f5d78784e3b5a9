"""Crossings of edges with scan lines: their positions, the pixels and faces beside them, and the chords of faces.

Scan lines are the rows of an image (axis 0) or its columns (axis 1). Rows measure the motion of edges along x, columns
along y. A line has the number u, and a position on it is v, both in pixels from the bottom left; pixel centres are the
integers.

``CROSSINGS`` declares C++ structs for native functions; Warp's code for the same formulas takes twice as long.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import SHORTEST
from ..warp.point import fill

wp.set_module_options({"enable_backward": False})

# A crossing is weighted by the inverse of a chord in pixels, the probability that a pixel centre hits the chord. The
# weight is at most 1 / LEAST_CHORD, to limit noise. This loses part of the gradient of shorter chords.
LEAST_CHORD = 0.02

# Pairs of centres sample only the inner half of a border pixel, so that half counts for both.
_BORDER_WEIGHT = "return v < 0.5f || v > (float)length - 1.5f ? 2.0f : 1.0f;"

_CROSSINGS = """
typedef wp::vec_t<3, float> vec3;

// The scan lines of one axis of one image, and what they show.
struct Lines {
    const vec3* faces;  // three corners each
    const int* adjacent;  // three faces each, across the edges; -1 for none
    const float *image, *grad;  // channels follow each other at a distance of ``area`` and ``grad_area``
    bool is_silhouette, halved;  // whether there is no image, and whether gradients are those of blocks of 2 x 2 pixels
    const int* shown;  // visible face of each pixel
    int channels, height, width, perspective, axis, count, length;  // ``count`` lines of ``length`` pixels
    wp::int64 area, grad_area;
    wp::int64 origin, across, along;  // in memory: pixel 0 of line 0, steps to the next line and the next pixel

    CUDA_CALLABLE void set(int in_axis) {
        axis = in_axis, count = axis ? width : height, length = axis ? height : width;
        area = (wp::int64)height * width, origin = area - width;
        across = axis ? 1 : -width, along = axis ? -width : 1;
    }
    CUDA_CALLABLE wp::int64 pixel(int u, int v) const { return origin + u * across + v * along; }
    // The place of a pixel's gradient.
    CUDA_CALLABLE wp::int64 pull(int u, int v) const {
        if (!halved) return pixel(u, v);
        const int row = height - 1 - (axis ? v : u), column = axis ? u : v;
        return (wp::int64)(row / 2) * (width / 2) + column / 2;
    }
    // The value of a channel at a pixel.
    CUDA_CALLABLE float value(const float* channel, wp::int64 pixel) const {
        return is_silhouette ? (shown[pixel] >= 0 ? 1.0f : 0.0f) : channel[pixel];
    }
    // The visible face at a pixel: -1 for none, -2 outside the image.
    CUDA_CALLABLE int face(int u, int v) const { return v < 0 || v >= length ? -2 : shown[pixel(u, v)]; }
    // The same as `to_pixels`.
    CUDA_CALLABLE float u_of(const vec3& p) const { return 0.5f * ((float)count * p[1 - axis] + (float)(count - 1)); }
    CUDA_CALLABLE float v_of(const vec3& p) const { return 0.5f * ((float)length * p[axis] + (float)(length - 1)); }
    static CUDA_CALLABLE float border_weight(float v, int length) { BORDER_WEIGHT }

    // The length from ``start`` to the exit of line u from a face, which it enters at ``entry``; at most a pixel.
    CUDA_CALLABLE float chord(int f, int u, float entry, float start) const {
        int edge;
        return wp::min(fabsf(exit(f, u, entry, edge) - start), 1.0f);
    }
    // The position where line u, which enters a face at ``entry``, leaves it, and the edge there; -1 if it misses it.
    CUDA_CALLABLE float exit(int f, int u, float entry, int& edge) const {
        const vec3* corners = faces + (wp::int64)f * 3;
        float us[3], vs[3], end = entry;
        edge = -1;
        for (int k = 0; k < 3; ++k) us[k] = u_of(corners[k]), vs[k] = v_of(corners[k]);
        for (int k = 0; k < 3; ++k) {
            const int m = k == 2 ? 0 : k + 1;
            if ((us[k] <= (float)u) == (us[m] <= (float)u)) continue;
            const float v = vs[k] + (vs[m] - vs[k]) * ((float)u - us[k]) / (us[m] - us[k]);
            if (fabsf(v - entry) > fabsf(end - entry)) end = v, edge = k;
        }
        return end;
    }
    static CUDA_CALLABLE float weight(float chord) { return 1.0f / wp::max(chord, LEAST_CHORD); }
};

// The point where a scan line crosses an edge, between the centres of two pixels.
struct Crossing {
    int u, inner, outer;  // the pixel on the face's side, and the one across the edge
    float v, share, offset;  // share: of q in the point's motion; offset: from the inner centre to the point, in [0, 1]
    int inner_face, outer_face;  // as `Lines::face`
};

// An edge p -> q of a counter-clockwise face with third corner r; u and v in pixels, depth z.
struct Edge {
    int face, adjacent, adjacent_pr, adjacent_qr;  // across p-q, p-r and q-r; -1 at a border of the surface
    bool small;  // see `seams`
    int outward;  // direction along v out of the face: 1 or -1
    float pu, pv, pz, qu, qv, qz, ru, rv, rz, slope;

    CUDA_CALLABLE void set(const Lines& lines, const vec3& p, const vec3& q, const vec3& r) {
        pu = lines.u_of(p), pv = lines.v_of(p), pz = p[2];
        qu = lines.u_of(q), qv = lines.v_of(q), qz = q[2];
        ru = lines.u_of(r), rv = lines.v_of(r), rz = r[2];
        slope = (qv - pv) / (qu - pu);
        outward = (pu < qu) == (lines.axis == 1) ? -1 : 1;
    }
    // Whether the edge has a slope, and both ends in front of the camera.
    CUDA_CALLABLE bool has_crossings(const Lines& lines) const {
        return !((fabsf(pu - qu) < SHORTEST) | (lines.perspective && ((pz <= 0.0f) | (qz <= 0.0f))));
    }
    // The first line that crosses the edge, and the one after the last; a line through a shared corner counts once.
    CUDA_CALLABLE int first(const Lines& lines) const { return line(lines, wp::min(pu, qu)); }
    CUDA_CALLABLE int end(const Lines& lines) const { return line(lines, wp::max(pu, qu)); }
    static CUDA_CALLABLE int line(const Lines& lines, float u) {
        return (int)ceilf(wp::min(wp::max(u, 0.0f), (float)lines.count));
    }
    CUDA_CALLABLE Crossing crossing(const Lines& lines, int u) const {
        Crossing at;
        at.u = u;
        at.v = wp::min(wp::max(pv + slope * ((float)u - pu), -2.0f), (float)lines.length + 1.0f);
        at.share = ((float)u - pu) / (qu - pu);
        at.inner = (int)(outward > 0 ? floorf(at.v) : ceilf(at.v));
        at.outer = at.inner + outward;
        at.offset = fabsf(at.v - (float)at.inner);
        at.inner_face = lines.face(u, at.inner), at.outer_face = lines.face(u, at.outer);
        return at;
    }
};
"""
CROSSINGS = fill(
    _CROSSINGS, BORDER_WEIGHT=_BORDER_WEIGHT, LEAST_CHORD=f"{LEAST_CHORD!r}f", SHORTEST=f"{float(SHORTEST)!r}f"
)


@wp.func_native(_BORDER_WEIGHT)
def border_weight(v: float, length: int) -> float:
    """Weight a position on a line of ``length`` pixels: 2 within half a pixel of the first or last centre, else 1."""
    ...
