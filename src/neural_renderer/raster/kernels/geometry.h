// Faces on the pixel grid: formulas that all operators share.
//
// Screen space: a corner is (x, y, z), x to the right and y up in [-1, 1] over the image, z the depth along the viewing
// axis. Pixel units: u = (size x + size - 1) / 2, so that pixel centres are the integers; rows count from the bottom.
// Maps in memory have row 0 at the top.
//
// A face with some corners behind the camera (z <= 0) still has a visible part. With a_k = w_k / z_k for the
// (extrapolated) screen-space weights w_k, a pixel shows the face where all a_k >= 0, at depth 1 / sum(a_k). This
// homogeneous form of the test needs no clipping (Olano and Greer, "Triangle scan conversion using 2D homogeneous
// coordinates", 1997).
#pragma once

#include "lanes.h"

namespace nr {

// Least resolved distance in screen units: four float32 roundings of a coordinate near 1.
constexpr float NARROWEST = 2.384185791015625e-07f;  // 2^-22
// Least extent of an edge across the scan lines, in pixels; a shorter edge has no slope. float32 resolves such extents
// only near pixel 0.
constexpr float SHORTEST = 1.0e-9f;

// The screen coordinate of the centre of pixel i, or of several.
template <class Ints>
NR_FUNC auto pixel_centre(Ints i, int size) {
    return to_floats(2 * i + 1 - size) / (float)size;
}

// The faces that an operator reads, and what each pixel shows.
struct Scene {
    const vec3* faces;      // corners on the screen, [images, count, 3]
    const int* face_index;  // visible face of each pixel, -1 for none, [images, height, width]; row 0 at the top
    int images;
    int count;         // faces of an image
    int height;        // pixels
    int width;         // pixels
    int perspective;   // whether the projection is perspective, else orthographic
    int below, above;  // rows of the whole image below and above this strip of it; both 0 for a whole image

    NR_FUNC int whole_height() const { return below + height + above; }
    NR_FUNC float centre_of_row(int j) const { return pixel_centre(below + j, whole_height()); }
    NR_FUNC const vec3* corners(int image, int face) const { return faces + ((int64)image * count + face) * 3; }
    // The offset of the first pixel of row j, counted from the bottom.
    NR_FUNC int64 row_start(int image, int j) const { return ((int64)image * height + height - 1 - j) * width; }
    NR_FUNC int64 area() const { return (int64)height * width; }
};

// Pixels [left, right] x [bottom, top]; rows count from the bottom.
struct Box {
    int left, right, bottom, top;

    NR_FUNC bool is_empty() const { return left > right || bottom > top; }
};

// Channel c of a face's attributes, interpolated with barycentric weights.
template <class F>
NR_FUNC F interpolated(const F* weights, const float* from, int c, int channels) {
    return weights[0] * from[c] + weights[1] * from[channels + c] + weights[2] * from[2 * channels + c];
}

// A screen coordinate in pixel units, where pixel centres are integers.
NR_FUNC float to_pixels(float x, int size) { return 0.5f * ((float)size * x + (float)(size - 1)); }

NR_FUNC int corners_behind(const vec3* v) { return (v[0][2] <= 0.0f) + (v[1][2] <= 0.0f) + (v[2][2] <= 0.0f); }

// The orientation of a face on the screen: 1 counter-clockwise, -1 clockwise, 0 if the corners are collinear.
NR_FUNC int facing(const vec3* v, int perspective) {
    const float left = (v[2][1] - v[0][1]) * (v[1][0] - v[0][0]), right = (v[1][1] - v[0][1]) * (v[2][0] - v[0][0]);
    const int side = (left > right) - (left < right);
    // Each corner behind the camera reverses the orientation of the projected triangle.
    return perspective && (corners_behind(v) & 1) ? -side : side;
}

// The side of a face that is visible: 0 the front, 1 the back.
NR_FUNC int visible_side(const vec3* v, int perspective) { return facing(v, perspective) < 0; }

// Twice the signed area on the screen, in screen units; equal to the bit in all CPU kernels.
NR_FUNC float doubled_area(const vec3* v) {
    NR_UNFUSED
    return (v[1][0] - v[0][0]) * (v[2][1] - v[0][1]) - (v[1][1] - v[0][1]) * (v[2][0] - v[0][0]);
}

// Whether a face is at most ``width`` wide on the screen: a barycentric weight changes by 1 over that, along x or y.
NR_FUNC bool is_narrow(const vec3* v, float width) {
    float longest = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const vec3 &a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
        longest = max(longest, max(fabsf(b[0] - a[0]), fabsf(b[1] - a[1])));
    }
    return fabsf(doubled_area(v)) <= width * longest;
}

NR_FUNC bool degenerate(const vec3* v) { return is_narrow(v, NARROWEST); }

// Classify a face: 1 in front of the camera, 0 across the camera's plane, -1 if it cannot be drawn. In orthographic
// projection every face is in front. Corners beyond 1e12 cannot be drawn, because their products overflow float32.
NR_FUNC int in_front(const vec3* v, int perspective) {
    bool fits = true;
    for (int n = 0; n < 3; ++n)
        for (int k = 0; k < 3; ++k) fits &= fabsf(v[n][k]) <= 1.0e12f;  // false for NaN, too
    if (!fits) return -1;
    const int behind = corners_behind(v);
    if (!perspective || behind == 0) return 1;
    // A corner on the camera's plane has no projection.
    return behind == 3 || v[0][2] == 0.0f || v[1][2] == 0.0f || v[2][2] == 0.0f ? -1 : 0;
}

// The pixels of [first, last] whose centres lie between two screen coordinates, widened by the rounding error.
NR_FUNC vec2i pixel_span(float low, float high, int size, int first, int last) {
    const float a = to_pixels(low, size) - 0.01f, b = to_pixels(high, size) + 0.01f;
    return {
        (int)ceilf(min(max(a, (float)first), (float)(last + 1))),
        (int)floorf(min(max(b, (float)(first - 1)), (float)last))};
}

// The bounding box of a face in pixels, for a `Scene` or another struct with the size of images; ``front`` as from
// `in_front`.
template <class Picture>
NR_FUNC Box pixel_box(const vec3* v, int front, const Picture& picture) {
    const int height = picture.height, width = picture.width, below = picture.below;
    if (front != 1) return {0, width - 1, 0, height - 1};
    const auto low = [v](int k) { return min(v[0][k], min(v[1][k], v[2][k])); };
    const auto high = [v](int k) { return max(v[0][k], max(v[1][k], v[2][k])); };
    const vec2i x = pixel_span(low(0), high(0), width, 0, width - 1);
    const vec2i y = pixel_span(low(1), high(1), picture.whole_height(), below, below + height - 1);
    return {x[0], x[1], y[0] - below, y[1] - below};
}

// The bounding box of a face of a scene; empty if the face cannot be drawn.
NR_FUNC Box box_of_face(const Scene& scene, int image, int face) {
    const vec3* v = scene.corners(image, face);
    const int front = in_front(v, scene.perspective);
    return front < 0 ? Box{0, -1, 0, -1} : pixel_box(v, front, scene);
}

// a_k = w_k / z_k at a screen position; in double, for corners near the camera's plane.
NR_NOINLINE vec3d homogeneous_weights(const vec3* v, float x, float y) {
    double e[3];
    for (int k = 0; k < 3; ++k) {
        const vec3 &a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
        e[k] = ((double)a[0] - x) * ((double)b[1] - y) - ((double)a[1] - y) * ((double)b[0] - x);
    }
    const double area = e[0] + e[1] + e[2];
    if (area == 0.0) return {-1.0, -1.0, -1.0};
    return {e[0] / (area * v[0][2]), e[1] / (area * v[1][2]), e[2] / (area * v[2][2])};
}

// The nearness of a point is 1 / z in perspective and -z in orthographic projection. It grows towards the camera and is
// linear over a face on the screen, so that depths compare without a division at each point.
NR_FUNC float nearness(float z, int perspective) { return perspective ? 1.0f / z : -z; }

// The terms of the nearness of a face's plane at a screen position, by corner: screen-space weight times nearness.
NR_FUNC vec3 nearness_terms(const vec3* v, float x, float y, int perspective) {
    const vec3d a = homogeneous_weights(v, x, y);
    vec3 terms;
    for (int k = 0; k < 3; ++k) terms[k] = perspective ? (float)a[k] : -((float)a[k] * v[k][2] * v[k][2]);
    return terms;
}
NR_FUNC float total(const vec3& terms) { return terms[0] + terms[1] + terms[2]; }

// The nearness of a face's plane at a screen position.
NR_FUNC float nearness_at(const vec3* v, float x, float y, int perspective) {
    return total(nearness_terms(v, x, y, perspective));
}

}  // namespace nr
