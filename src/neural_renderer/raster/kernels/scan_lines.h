// Scan lines, along which the gradients through visibility measure the motion of edges.
//
// The rows of an image (axis 0) measure motion along x, its columns (axis 1) motion along y. u is the index of a line
// and v a position on it, both in pixels from the bottom left; pixel centres are integers.
#pragma once

#include "geometry.h"

namespace nr {

// The lines of one axis: ``count`` lines of ``length`` pixels.
struct ScanAxis {
    int axis, count, length;
    int64 origin, across, along;  // offset of pixel 0 of line 0; strides to the next line and pixel
    int below, whole;             // rows of the whole image below the first one, and all of them

    NR_FUNC ScanAxis(int axis, int height, int width, int below = 0, int above = 0)
        : axis(axis),
          count(axis ? width : height),
          length(axis ? height : width),
          origin((int64)(height - 1) * width),
          across(axis ? 1 : -width),
          along(axis ? -width : 1),
          below(below),
          whole(below + height + above) {}

    // The offset of a pixel in a map [height, width].
    NR_FUNC int64 pixel(int u, int v) const { return origin + u * across + v * along; }
    NR_FUNC float column_of(const vec3& p) const { return to_pixels(p[0], axis ? count : length); }
    NR_FUNC float row_of(const vec3& p) const { return to_pixels(p[1], whole) - (float)below; }
    NR_FUNC int whole_length() const { return axis ? whole : length; }
    // The screen position of v on line u.
    NR_FUNC vec2 place(float u, float v) const {
        const float column = axis ? u : v, row = axis ? v : u, width = (float)(axis ? count : length);
        const float height = (float)whole;
        return {(2.0f * column + 1.0f - width) / width, (2.0f * (row + (float)below) + 1.0f - height) / height};
    }
    NR_FUNC float u_of(const vec3& p) const { return axis ? column_of(p) : row_of(p); }
    NR_FUNC float v_of(const vec3& p) const { return axis ? row_of(p) : column_of(p); }
};

// An edge p -> q of a counter-clockwise face with third corner r.
struct LineEdge {
    float pu, qu, ru, pv, qv, rv, slope;
    int outward;  // direction along v out of the face: 1 or -1

    NR_FUNC LineEdge(const ScanAxis& lines, const vec3& p, const vec3& q, const vec3& r)
        : pu(lines.u_of(p)),
          qu(lines.u_of(q)),
          ru(lines.u_of(r)),
          pv(lines.v_of(p)),
          qv(lines.v_of(q)),
          rv(lines.v_of(r)) {
        slope = (qv - pv) / (qu - pu);
        outward = (pu < qu) == (lines.axis == 1) ? -1 : 1;
    }
    NR_FUNC bool has_slope() const { return !(fabsf(pu - qu) < SHORTEST); }
};

}  // namespace nr
