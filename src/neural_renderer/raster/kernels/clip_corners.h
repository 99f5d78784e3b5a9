// Triangles in clip space, as corners on the screen that can be drawn: (x / w, -y / w, z / w + 2). Row 0 of images that
// are drawn is at the top, and drawing needs positive depths.
//
// A triangle that reaches behind the camera is replaced by its part between the planes z = -w and z = w, where w is
// positive (Sutherland and Hodgman, "Reentrant polygon clipping", 1974).
#pragma once

#include "clip.h"

namespace nr {

// Triangles that remain, at most, of one that two planes cut.
constexpr int MOST_PARTS = 3;

struct ClipCorners {
    ClipMesh mesh;
    DrawnTriangles drawn;
    int parts;      // 1 for whole triangles only, else MOST_PARTS
    int* behind;    // becomes 1 where a triangle reaches behind the camera, [1]; may be null
    vec3* corners;  // [images, parts, slots, 3]; NaN for parts that a triangle does not have
};

NR_FUNC vec3 on_screen(const float* v) { return {{v[0] / v[3], -v[1] / v[3], v[2] / v[3] + 2.0f}}; }
NR_FUNC vec3 on_screen(const double* v) {
    return {{(float)(v[0] / v[3]), (float)(-v[1] / v[3]), (float)(v[2] / v[3] + 2.0)}};
}

// A convex polygon in clip space.
struct ClipPolygon {
    double v[5][4];
    int count;

    NR_FUNC void append(const double* vertex) {
        for (int c = 0; c < 4; ++c) v[count][c] = vertex[c];
        ++count;
    }
    // The part where w + sign z is positive.
    NR_FUNC ClipPolygon above(double sign) const {
        NR_UNFUSED
        ClipPolygon kept;
        kept.count = 0;
        for (int k = 0; k < count; ++k) {
            const double *a = v[k], *b = v[k + 1 < count ? k + 1 : 0];
            const double from_a = a[3] + sign * a[2], from_b = b[3] + sign * b[2];
            if (from_a > 0.0) kept.append(a);
            if ((from_a > 0.0) == (from_b > 0.0)) continue;
            // Interpolates from the inner end, so that both triangles at this edge are cut at the same point.
            const double *in = from_a > 0.0 ? a : b, *out = from_a > 0.0 ? b : a;
            const double inside = from_a > 0.0 ? from_a : from_b, outside = from_a > 0.0 ? from_b : from_a;
            double cut[4];
            for (int c = 0; c < 4; ++c) cut[c] = in[c] + (out[c] - in[c]) * (inside / (inside - outside));
            kept.append(cut);
        }
        return kept;
    }
};

// Write the parts of a triangle between the planes, ``step`` corners apart; returns their number.
NR_NOINLINE int cut_triangle(const float* positions, const int* corner, vec3* to, int64 step) {
    ClipPolygon whole;
    whole.count = 0;
    for (int k = 0; k < 3; ++k) {
        const float* at = positions + (int64)corner[k] * 4;
        const double vertex[4] = {at[0], at[1], at[2], at[3]};
        whole.append(vertex);
    }
    const ClipPolygon inside = whole.above(1.0).above(-1.0);
    for (int n = 0; n < inside.count - 2; ++n)
        for (int k = 0; k < 3; ++k) to[n * step + k] = on_screen(inside.v[k ? n + k : 0]);
    return max(inside.count - 2, 0);
}

// One triangle in one image.
NR_FUNC void clip_corners(const ClipCorners& call, int task) {
    const ClipMesh& mesh = call.mesh;
    const int slots = call.drawn.slots, image = task / slots, slot = task % slots;
    const float* positions = mesh.positions + mesh.start(image);
    const int* corner = mesh.corners(call.drawn.triangle(image, slot));
    vec3* to = call.corners + ((int64)image * call.parts * slots + slot) * 3;
    const int64 step = (int64)slots * 3;
    int written = 0;
    bool behind = false;
    for (int k = 0; corner && k < 3; ++k) behind |= positions[(int64)corner[k] * 4 + 3] <= 0.0f;
    if (behind && call.parts == 1) {
        if (call.behind) store_relaxed(call.behind, 1);
    } else if (behind) {
        written = cut_triangle(positions, corner, to, step);
    } else if (corner) {
        for (int k = 0; k < 3; ++k) to[k] = on_screen(positions + (int64)corner[k] * 4);
        written = 1;
    }
    for (int n = written; n < call.parts; ++n)
        for (int k = 0; k < 3; ++k) to[n * step + k] = {{NAN, NAN, NAN}};
}

}  // namespace nr
