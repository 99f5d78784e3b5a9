// Crossings of visible boundaries with scan lines: their positions, the adjacent pixels and faces, the colours on both
// sides, and the change of the loss or of the image if the boundary moves there.
#pragma once

#include "queue.h"
#include "scan_lines.h"

namespace nr {

// A crossing is weighted by the inverse of a chord in pixels, which is the probability that a pixel centre hits the
// chord. The weight is at most 1 / LEAST_CHORD, to limit noise; shorter chords lose part of their gradient.
constexpr float LEAST_CHORD = 0.02f;

// Images, and the gradient to the images.
struct Pictures {
    const float* image;  // [images, channels, height, width]; null for the silhouette
    // [images, channels, height, width]; or, if ``halved``, to the means of blocks of 2 x 2 pixels,
    // [images, channels, height / 2, width / 2]
    const float* grad;
    int channels, halved;
    // Values of the last ``known`` channels at the corners of faces, [owners, count, 3, known]; see corner_values.h. If
    // there are other channels, too, the known values continue over seams.
    const float* corner_values;
    int owners, known;
};

// Pairs of pixel centres sample only the inner half of a border pixel, so this half counts for both: a position within
// half a pixel of the first or last centre of a line counts twice.
NR_FUNC float border_weight(float v, int length) { return v < 0.5f || v > (float)length - 1.5f ? 2.0f : 1.0f; }

NR_FUNC float weight_of_chord(float chord) { return 1.0f / max(chord, LEAST_CHORD); }

// Most faces that a scan line is followed through: stand-ins behind the face of an outline, enough for a bevel of three
// strips, or those up to a place; more would take time.
constexpr int LONGEST = 6;

// The pixels of an image along the scan lines of one axis.
struct Lines : ScanAxis {
    int height, width, channels, sampled, perspective;  // sampled: channels without values at corners, the first ones
    bool halved;
    const vec3* faces;          // [count, 3]
    const int* adjacent;        // faces across the edges, -1 for none, [count, 3]
    const int* shown;           // visible face of each pixel
    const float *image, *grad;  // channels follow each other at a distance of ``area`` and ``grad_area``
    int64 area, grad_area;
    const float* corner_values;  // [count, 3, channels - sampled]

    NR_FUNC Lines(int axis, const Scene& scene, const Pictures& pictures, const int* adjacent, int b)
        : ScanAxis(axis, scene.height, scene.width, scene.below, scene.above),
          height(scene.height),
          width(scene.width),
          channels(pictures.channels),
          sampled(pictures.channels - pictures.known),
          perspective(scene.perspective),
          halved(pictures.halved),
          faces(scene.corners(b, 0)),
          adjacent(adjacent + (int64)b * scene.count * 3),
          shown(scene.face_index + b * scene.area()),
          image(pictures.image ? pictures.image + b * channels * scene.area() : nullptr),
          area(scene.area()),
          grad_area(halved ? area / 4 : area) {
        grad = pictures.grad + b * channels * grad_area;
        const int64 own = (int64)broadcast(b, pictures.owners) * scene.count * 3;
        corner_values = pictures.known ? pictures.corner_values + own * pictures.known : nullptr;
    }

    // With 2x2 supersampling, each sample carries a quarter of its pixel's gradient.
    NR_FUNC float share_of_pixel() const { return halved ? 0.25f : 1.0f; }
    // The offset of a pixel's gradient.
    NR_FUNC int64 grad_index(int u, int v) const {
        if (!halved) return pixel(u, v);
        const int row = height - 1 - (axis ? v : u), column = axis ? u : v;
        return (int64)(row / 2) * (width / 2) + column / 2;
    }
    NR_FUNC float value(int channel, int64 pixel) const {
        return image ? image[channel * area + pixel] : shown[pixel] >= 0 ? 1.0f : 0.0f;
    }
    // Known values of a corner of a face; channel 0 of the image is at 0.
    NR_FUNC const float* known_value(int f, int corner) const {
        return corner_values + ((int64)f * 3 + corner) * (channels - sampled) - sampled;
    }
    // The visible face at a pixel: -1 for none, -2 outside the image.
    NR_FUNC int face(int u, int v) const { return v < 0 || v >= length ? -2 : shown[pixel(u, v)]; }

    // The length from ``start`` to the exit of line u from a face that it enters at ``entry``; at most one pixel.
    NR_FUNC float chord(int f, int u, float entry, float start) const {
        int edge;
        return min(fabsf(exit(f, u, entry, edge) - start), 1.0f);
    }
    // Follow line u through a face that it enters at v: move v to its exit, and return the face there; -1 for none.
    NR_FUNC int cross(int f, int u, float& v) const {
        int edge;
        v = exit(f, u, v, edge);
        return edge < 0 ? -1 : adjacent[(int64)f * 3 + edge];
    }
    // Follow the surface of a visible face along line u, in direction 1 or -1: the face at v; -1 if it ends before.
    NR_FUNC int follow(int face, int u, float v, int direction) const {
        float exit = -65536.0f * (float)direction;  // from afar, so that the first face is left in the direction
        for (int n = 0; n < LONGEST && face >= 0; ++n) {
            const int next = cross(face, u, exit);
            if ((exit - v) * (float)direction >= 0.0f) return face;
            face = next;
        }
        return -1;
    }
    // The position where line u, which enters a face at ``entry``, leaves it, and the edge there; -1 if it misses it.
    NR_FUNC float exit(int f, int u, float entry, int& edge) const {
        const vec3* corners = faces + (int64)f * 3;
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
};

// The point where a scan line crosses an edge, between the centres of two pixels.
struct Crossing {
    int u, inner, outer;         // the pixel on the face's side, and the one across the edge
    float v, share, offset;      // share: of q in the point's motion; offset: from the inner centre to it, in [0, 1]
    int inner_face, outer_face;  // faces as from `Lines::face`
};

// The third corner of a face, beside the edge p - q, and the faces across its other edges; -1 at a border of the
// surface.
struct ThirdCorner {
    float u, v;
    int at_p, at_q;
};

// An edge p -> q of a counter-clockwise face, its depths, and the faces next to it.
struct BoundaryEdge : LineEdge {
    float pz, qz, rz;
    int first, end;                    // the first line that crosses the edge, and the one after the last
    int face, adjacent;                // -1 at a border of the surface
    int p, q;                          // numbers of its ends among the corners of the face
    ThirdCorner third, across;         // of the face, and of the adjacent one if values are known
    const float *across_p, *across_q;  // known values of the adjacent face at p and q
    bool small = false;                // see `is_small` in edge.h

    NR_FUNC BoundaryEdge(const Lines& lines, const vec3& p, const vec3& q, const vec3& r)
        : LineEdge(lines, p, q, r), pz(p[2]), qz(q[2]), rz(r[2]), first(0), end(0), third{ru, rv, -1, -1} {
        // An edge needs a slope, and both ends in front of the camera.
        if (!has_slope() | (lines.perspective && ((pz <= 0.0f) | (qz <= 0.0f)))) return;
        first = line_from(lines, min(pu, qu)), end = line_from(lines, max(pu, qu));
    }
    // A line through a shared corner counts once.
    NR_FUNC static int line_from(const Lines& lines, float u) {
        return (int)ceilf(min(max(u, 0.0f), (float)lines.count));
    }
    NR_FUNC bool has_crossings() const { return first < end; }
    // Find where line u, which crosses the edge, leaves a face beside the edge, and return the next face there.
    NR_FUNC int leave(int u, const ThirdCorner& third, float& exit) const {
        const bool at_p = (pu <= (float)u) != (third.u <= (float)u);
        const float from_u = at_p ? pu : qu, from_v = at_p ? pv : qv;
        exit = from_v + (third.v - from_v) * ((float)u - from_u) / (third.u - from_u);
        return at_p ? third.at_p : third.at_q;
    }
    NR_FUNC float nearness_at(const Lines& lines, const Crossing& at) const {
        return (1.0f - at.share) * nearness(pz, lines.perspective) + at.share * nearness(qz, lines.perspective);
    }
    NR_FUNC Crossing crossing(const Lines& lines, int u) const {
        Crossing at;
        at.u = u;
        at.v = min(max(pv + slope * ((float)u - pu), -2.0f), (float)lines.length + 1.0f);
        at.share = ((float)u - pu) / (qu - pu);
        at.inner = (int)(outward > 0 ? floorf(at.v) : ceilf(at.v));
        at.outer = at.inner + outward;
        at.offset = fabsf(at.v - (float)at.inner);
        at.inner_face = lines.face(u, at.inner), at.outer_face = lines.face(u, at.outer);
        return at;
    }
};

// The nearness of a face's plane, clamped to the range of its corners, because within a pixel the plane of a face seen
// edge-on takes any value. A face with a corner behind the camera is not clamped.
NR_FUNC float clamped_nearness_at(const vec3* v, float x, float y, int perspective) {
    const float near = nearness_at(v, x, y, perspective);
    if (perspective && ((v[0][2] <= 0.0f) | (v[1][2] <= 0.0f) | (v[2][2] <= 0.0f))) return near;
    const float a = nearness(v[0][2], perspective), b = nearness(v[1][2], perspective);
    const float c = nearness(v[2][2], perspective);
    return min(max(near, min(a, min(b, c))), max(a, max(b, c)));
}

// How much nearer a crossing is than face f at position v of the crossing's line.
NR_FUNC float lead_over_face(const Lines& lines, const BoundaryEdge& edge, const Crossing& at, int f, float v) {
    const vec2 place = lines.place((float)at.u, v);
    const float there = clamped_nearness_at(lines.faces + (int64)f * 3, place[0], place[1], lines.perspective);
    return edge.nearness_at(lines, at) - there;
}

// The colour on one side of a boundary, blended from two or three pixels: their offsets and weights.
struct Blend {
    int64 near, next, third;
    float near_weight, next_weight, third_weight = 0.0f;

    NR_FUNC float of(const Lines& lines, int channel) const {
        const float two = near_weight * lines.value(channel, near) + next_weight * lines.value(channel, next);
        return third_weight == 0.0f ? two : two + third_weight * lines.value(channel, third);
    }
    // Extrapolate to the boundary, ``offset`` pixels from the near centre, if both pixels show the same face, so that
    // the colour is ``linear``. Otherwise take the colour of the near pixel.
    NR_FUNC void extrapolate(float weight, float offset, bool linear) {
        near_weight = linear ? weight * (1.0f + offset) : weight;
        next_weight = linear ? -weight * offset : 0.0f;
    }
};

// The pixels whose gradients a crossing takes: offsets into a map of gradients, and the share of the outer one. The
// pixel that contains the boundary stands for both, unless a side is ``narrow``: then a visible centre may lie anywhere
// in it.
struct EdgePixels {
    int64 inner, outer;
    float share;

    NR_FUNC EdgePixels(const Lines& lines, const Crossing& at, bool narrow) : share(narrow ? at.offset : 0.0f) {
        inner = lines.grad_index(at.u, narrow || at.offset < 0.5f ? at.inner : at.outer);
        outer = narrow ? lines.grad_index(at.u, at.outer) : inner;
    }
};

// The change of the image if a visible boundary moves outward by a pixel: the difference of its two colours.
struct Gain {
    Blend inside, outside;
    bool before_is_inside, behind_is_outside;  // whether the next pixels show the same faces as the near ones

    // Start with the two pixels on either side of a crossing, and the next ones along the line.
    NR_FUNC Gain(const Lines& lines, const BoundaryEdge& edge, const Crossing& at) {
        const int before = at.inner - edge.outward, behind = at.outer + edge.outward, last = lines.length - 1;
        before_is_inside = lines.face(at.u, before) == at.inner_face;
        behind_is_outside = lines.face(at.u, behind) == at.outer_face;
        inside.near = lines.pixel(at.u, at.inner), outside.near = lines.pixel(at.u, at.outer);
        inside.next = lines.pixel(at.u, before < 0 ? 0 : before > last ? last : before);
        outside.next = lines.pixel(at.u, behind < 0 ? 0 : behind > last ? last : behind);
    }
    // Call sink(channel, pixels, inside - outside) for each sampled channel.
    template <class Sink>
    NR_FUNC void give(const Lines& lines, const EdgePixels& pixels, Sink& sink) const {
        for (int c = 0; c < lines.sampled; ++c) sink(c, pixels, inside.of(lines, c) - outside.of(lines, c));
    }
};

// Reverse mode: a sink that sums colour differences times the gradients of pixels, the change of the loss.
struct Adjoint {
    const Lines& lines;
    float part = 1.0f;  // fraction of the sum that belongs to the edge
    float sum = 0.0f;

    NR_FUNC void operator()(int c, const EdgePixels& pixels, float difference) {
        const float* grad = lines.grad + c * lines.grad_area;
        sum += difference * ((1.0f - pixels.share) * grad[pixels.inner] + pixels.share * grad[pixels.outer]);
    }
};

// Forward mode: a sink that adds colour differences, times the outward motion of the crossing in pixels, to the
// tangents of images in several directions.
struct Tangent {
    static constexpr int MOST = 8;  // most directions of one sink
    const Lines& lines;
    int directions;
    float* image;  // change of the image in the first direction
    int64 area;    // from one direction to the next
    float motion[MOST];
    float part = 1.0f;  // fraction of the change that belongs to the edge

    NR_FUNC void operator()(int c, const EdgePixels& pixels, float difference) {
        float* to = image + c * lines.grad_area;
        for (int t = 0; t < directions; ++t, to += area) {
            const float change = part * motion[t] * difference;
            if (pixels.share < 1.0f) atomic_add(to + pixels.inner, (1.0f - pixels.share) * change);
            if (pixels.share > 0.0f) atomic_add(to + pixels.outer, pixels.share * change);
        }
    }
};

}  // namespace nr
