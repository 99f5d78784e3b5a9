// The unbiased gradient where faces intersect: the motion of the line at which their depths are equal.
//
// Two neighbouring pixels show two faces that have the same nearness at a point between the pixel centres. Nearness is
// linear on the screen. Let a be the lead of the first face, its nearness minus that of the other face at its pixel,
// and b the lead of the other face at the other pixel. Then the point lies t = a / (a + b) pixels from the first
// centre, and moves by d(lead) / (a + b) pixels if a corner changes the lead there. The gradient to the corner, in x, y
// and z, is this motion, times the difference of the two colours, times the gradient of the pixel that contains the
// point.
//
// Rows and columns both sample the line. Each pair is weighted by the squared component of the line's normal along its
// axis; over the two axes the weights sum to 1. Near the edge of a face a pair may miss one of the faces, so the
// weights are divided by their mean over sub-pixel shifts: the sum of the squares times the probabilities of a hit. On
// the CPU products and sums are not fused, because leads are small differences.
#pragma once

#include "crossings.h"
#include "lanes.h"
#include "neighbors.h"
#include "tasks.h"

namespace nr {

struct Intersections {
    Scene scene;
    Pictures pictures;    // an image, and the gradient of each pixel
    const int* adjacent;  // faces across the edges, -1 for none, [images, count, 3]
    int* candidates;      // mask of faces that may intersect a neighbour, [images, count], 0 before; on the CPU
    int each;             // rows of a task
    vec3* to_faces;       // gradient to the corners, [images, count, 3]; added to
};

// ---- Candidates: a cheap test that rejects most pairs of faces ----

// The fraction of the segment from (x, y), inside a face, to (x2, y2) that the face covers, up to its first edge.
NR_FUNC float covered_fraction(const vec3* v, float x, float y, float x2, float y2) {
    const float area = (v[1][0] - v[0][0]) * (v[2][1] - v[0][1]) - (v[1][1] - v[0][1]) * (v[2][0] - v[0][0]);
    float end = 1.0f;
    for (int k = 0; k < 3; ++k) {
        const vec3 &p = v[k], &q = v[k == 2 ? 0 : k + 1];
        const float s = area < 0.0f ? -1.0f : 1.0f, dx = s * (q[0] - p[0]), dy = s * (q[1] - p[1]);
        const float here = dx * (y - p[1]) - dy * (x - p[0]), there = dx * (y2 - p[1]) - dy * (x2 - p[0]);
        const float doubt = 1.0e-6f * (fabsf(dx) + fabsf(dy));
        const bool leaves = (there < -doubt) & (here > there);
        const float at = (leaves ? here + doubt : 1.0f) / (leaves ? here - there : 1.0f);
        end = at < end ? at : end;
    }
    return end;
}

// Whether face f, shown at pixel i of a row from the top, and another one, shown at the next pixel to the right or
// below (``down``), may intersect between them. Together they must cover the whole segment between the pixels.
NR_FUNC bool may_meet(const Intersections& call, int image, int f, int other, int i, int row, bool down) {
    const Scene& scene = call.scene;
    const int perspective = scene.perspective;
    const int* next = call.adjacent + ((int64)image * scene.count + f) * 3;
    // A sum, for one branch: at which edge the other face lies is hard to predict.
    if ((other == next[0]) + (other == next[1]) + (other == next[2]) > 0) return false;
    const vec3 *v = scene.corners(image, f), *u = scene.corners(image, other);
    const bool in_front =
        (v[0][2] > 0.0f) & (v[1][2] > 0.0f) & (v[2][2] > 0.0f) & (u[0][2] > 0.0f) & (u[1][2] > 0.0f) & (u[2][2] > 0.0f);
    if (perspective && !in_front) return true;
    const float x = pixel_centre(i, scene.width), y = scene.centre_of_row(scene.height - 1 - row);
    const float x2 = down ? x : x + 2.0f / (float)scene.width, y2 = down ? y - 2.0f / (float)scene.whole_height() : y;
    const float own_here = nearness_at(v, x, y, perspective);
    const float ahead = own_here - nearness_at(u, x, y, perspective);
    if (!(ahead > 0.0f)) return false;  // as on a convex surface
    const float short_of = nearness_at(u, x2, y2, perspective) - nearness_at(v, x2, y2, perspective);
    if (!(short_of > 0.0f && ahead + short_of > 1.0e-6f * fabsf(own_here))) return false;
    return covered_fraction(v, x, y, x2, y2) + covered_fraction(u, x2, y2, x, y) >= 0.999f;
}

// Mark both faces of a pair of pixels as candidates, unless the pixels have equal colours.
NR_FUNC void mark_pair(const Intersections& call, int image, int i, int row, bool down) {
    const Scene& scene = call.scene;
    const int64 here = (int64)row * scene.width + i, there = here + (down ? scene.width : 1);
    const int* shown = scene.face_index + image * scene.area();
    const int f = shown[here], other = shown[there];
    if (!may_meet(call, image, f, other, i, row, down)) return;
    const float* color = call.pictures.image + image * call.pictures.channels * scene.area();
    bool differs = false;
    for (int c = 0; c < call.pictures.channels; ++c, color += scene.area()) differs |= color[here] != color[there];
    if (!differs) return;
    store_relaxed(call.candidates + (int64)image * scene.count + f, 1);
    store_relaxed(call.candidates + (int64)image * scene.count + other, 1);
}

// Call visit(image, i, row, down) for the pixels i of a task in a line, if the next one to the right (``right``) or
// below (``down``) shows another face. Lines count from the top over all images, rows in their image.
template <class Visit>
NR_FUNC void for_each_pair(const Scene& scene, int line, const Pixels& pixels, bool right, Visit visit) {
    const int image = line / scene.height, row = line - image * scene.height;
    const int* shown = scene.face_index + (int64)line * scene.width;
    for (int down = right ? 0 : 1; down < 2; ++down) {
        if (down && row + 1 == scene.height) break;
        // The last pixel has none to the right.
        const int end = min(pixels.right, down ? scene.width : scene.width - 1);
        for (int at = pixels.left; at < end; at += 64) {  // long loops: the end of a short one is hard to predict
            const int step = down ? scene.width : 1;
            for (uint64 pairs = changes_of_face(shown + at, step, end - at); pairs; pairs &= pairs - 1) {
                const int i = at + lowest_bit(pairs);
                if ((shown[i] >= 0) & (shown[i + step] >= 0)) visit(image, i, row, down == 1);
            }
        }
    }
}

// Mark pairs of faces that may intersect between a pixel of a task and its neighbour to the right or below. Several
// tasks may write to one address, but all of them write 1.
NR_FUNC void find_candidates(const Intersections& call, int task) {
    const Scene& scene = call.scene;
    const Pixels pixels = pixels_of_task(task, call.each, scene.images * scene.height, scene.width);
    for (int line = pixels.first; line < pixels.last; ++line)
        for_each_pair(scene, line, pixels, true, [&](int image, int i, int row, bool down) {
            mark_pair(call, image, i, row, down);
        });
}

// ---- The gradient of a pair of pixels ----

// Two neighbouring pixels of an image, (i, j) and (i2, j2): column and row from the bottom left.
struct PixelPair {
    int image, axis, step;  // the axis along which they are neighbours; from the first to the second: 1 or -1
    int i, j, i2, j2;

    // Pair a pixel with its neighbour on one of four sides: right, left, above, below.
    NR_FUNC PixelPair(int image, int i, int j, int side)
        : image(image),
          axis(side / 2),
          step(1 - 2 * (side % 2)),
          i(i),
          j(j),
          i2(i + step * (1 - axis)),
          j2(j + step * axis) {}

    // The visible face at the second pixel; -1 for none, and outside the image.
    NR_FUNC int second_face(const Scene& scene) const {
        if (i2 < 0 || i2 >= scene.width || j2 < 0 || j2 >= scene.height) return -1;
        return scene.face_index[scene.row_start(image, j2) + i2];
    }
};

// The point between two pixels at which a face and another one have the same nearness.
struct Intersection {
    bool exists;
    float t;         // distance from the first pixel, in pixels
    float lead;      // sum of the leads of both faces, each at its own pixel
    vec3 terms;      // terms of the first face's nearness at the point, by corner
    vec2 own_slope;  // change of the first face's nearness over a pixel to the right and up
    vec2 slope;      // change of the first face's lead
    float sampled;   // squared slope, each axis times the probability that a pair of pixels shows both faces
};

// Whether two faces have two corners in common: such faces meet at an edge and do not intersect.
NR_FUNC bool share_edge(const vec3* v, const vec3* u) {
    int count = 0;
    for (int k = 0; k < 3; ++k) count += same(v[k], u[0]) || same(v[k], u[1]) || same(v[k], u[2]);
    return count >= 2;
}

// Whether the position with these nearness terms lies inside the face.
NR_FUNC bool covers(const vec3& terms, int perspective) {
    if (perspective) return terms[0] >= 0.0f && terms[1] >= 0.0f && terms[2] >= 0.0f;
    return terms[0] <= 0.0f && terms[1] <= 0.0f && terms[2] <= 0.0f;
}

// The change of a face's nearness over a pixel to the right and a pixel up; it is ``here`` at (x, y).
NR_FUNC vec2 nearness_slope(const vec3* v, float x, float y, float here, const vec2& pixel, int perspective) {
    const float right = nearness_at(v, x + pixel[0], y, perspective) - here;
    const float up = nearness_at(v, x, y + pixel[1], perspective) - here;
    return {right, up};
}

NR_FUNC vec2 size_of_pixel(const Scene& scene) {
    return {2.0f / (float)scene.width, 2.0f / (float)scene.whole_height()};
}

NR_FUNC bool has_gradient(const vec3* v, int perspective) { return in_front(v, perspective) == 1 && !degenerate(v); }

// The point where face f, visible at the first pixel of a pair, and face g, visible at the second, are equally near.
NR_FUNC Intersection find_intersection(const Scene& scene, const PixelPair& pair, int f, int g) {
    NR_UNFUSED
    Intersection found = {};
    const int perspective = scene.perspective;
    const vec3 *v = scene.corners(pair.image, f), *u = scene.corners(pair.image, g);
    if (!has_gradient(u, perspective)) return found;
    const float x = pixel_centre(pair.i, scene.width), y = scene.centre_of_row(pair.j);
    const float x2 = pixel_centre(pair.i2, scene.width), y2 = scene.centre_of_row(pair.j2);
    const vec3 own_first = nearness_terms(v, x, y, perspective), own_second = nearness_terms(v, x2, y2, perspective);
    const vec3 other_first = nearness_terms(u, x, y, perspective);
    const vec3 other_second = nearness_terms(u, x2, y2, perspective);
    const float own_lead = total(own_first) - total(other_first);
    const float other_lead = total(other_second) - total(own_second);
    found.lead = own_lead + other_lead;
    // The leads of faces in one plane are rounding errors.
    if (!(own_lead > 0.0f && other_lead > 0.0f && found.lead > 1.0e-6f * fabsf(total(own_first)))) return found;
    found.t = own_lead / found.lead;
    found.terms = own_first + found.t * (own_second - own_first);
    const vec3 other_terms = other_first + found.t * (other_second - other_first);
    if (!covers(found.terms, perspective) || !covers(other_terms, perspective)) return found;
    const vec2 pixel = size_of_pixel(scene);
    found.exists = true;
    found.own_slope = nearness_slope(v, x, y, total(own_first), pixel, perspective);
    const vec2 other_slope = nearness_slope(u, x, y, total(other_first), pixel, perspective);
    // Each face is visible on its side of the point up to its edge; a pair of pixels shows both if it hits both parts.
    const float x_at = x + found.t * (x2 - x), y_at = y + found.t * (y2 - y);
    for (int axis = 0; axis < 2; ++axis) {
        vec2 step = {};
        found.slope[axis] = found.own_slope[axis] - other_slope[axis];
        step[axis] = found.slope[axis] < 0.0f ? -pixel[axis] : pixel[axis];
        const float both = covered_fraction(v, x_at, y_at, x_at + step[0], y_at + step[1])
            + covered_fraction(u, x_at, y_at, x_at - step[0], y_at - step[1]);
        found.sampled += found.slope[axis] * found.slope[axis] * max(both - 1.0f, 0.0f);
    }
    return found;
}

// Sum (first - second colour) * gradient over the channels; ``at_second``: the second pixel has the gradient.
NR_FUNC float color_difference(const Intersections& call, const PixelPair& pair, bool at_second) {
    NR_UNFUSED
    const Lines rows(0, call.scene, call.pictures, call.adjacent, pair.image);
    const float* first = rows.image + rows.pixel(pair.j, pair.i);
    const float* second = rows.image + rows.pixel(pair.j2, pair.i2);
    const float* grad = rows.grad + (at_second ? rows.grad_index(pair.j2, pair.i2) : rows.grad_index(pair.j, pair.i));
    float result = 0.0f;
    for (int c = 0; c < rows.channels; ++c)
        result += (first[c * rows.area] - second[c * rows.area]) * grad[c * rows.grad_area];
    return rows.share_of_pixel() * result;
}

// The motion of an intersection along its pair, in pixels, per unit of the first face's nearness there, times the
// weight of the pair.
NR_FUNC float motion_by_nearness(const Intersection& found, const PixelPair& pair) {
    NR_UNFUSED
    const vec2& slope = found.slope;
    const float square = slope[0] * slope[0] + slope[1] * slope[1], along = slope[pair.axis];
    return along * along / max(found.sampled, LEAST_CHORD * square) / found.lead;
}

NR_FUNC float border_weight(const Scene& scene, const Intersection& found, const PixelPair& pair) {
    const float v = (float)(pair.axis ? pair.j : pair.i) + (float)pair.step * found.t;
    return border_weight(v, pair.axis ? scene.height : scene.width);
}

// The derivative of the first face's nearness at an intersection with respect to its corner k, times ``gain``.
//
// At a fixed position, moving corner k by s on the screen changes the nearness by -w_k grad(nearness) . s, and moving
// its depth by dz changes it by w_k dn_k/dz dz.
NR_FUNC vec3 nearness_by_corner(const Scene& scene, const Intersection& found, const vec3* v, int k, float gain) {
    NR_UNFUSED
    const vec2 pixel = size_of_pixel(scene);
    const float z = v[k][2], w = scene.perspective ? found.terms[k] * z : -found.terms[k] / z;
    const float to_z = scene.perspective ? -w / (z * z) : -w;
    return {-(gain * w * found.own_slope[0] / pixel[0]), -(gain * w * found.own_slope[1] / pixel[1]), gain * to_z};
}

// The intersection of face f, visible at the first pixel of a pair, with the face at the second one.
NR_FUNC Intersection intersection_of_pair(const Scene& scene, const PixelPair& pair, int f) {
    const int other = pair.second_face(scene);
    if (other < 0 || other == f || share_edge(scene.corners(pair.image, f), scene.corners(pair.image, other)))
        return Intersection{};
    return find_intersection(scene, pair, f, other);
}

// Add the gradients to the corners of face f, visible at the first pixel of a pair.
NR_FUNC void add_pair(const Intersections& call, const PixelPair& pair, int f, vec3* to) {
    NR_UNFUSED
    const Scene& scene = call.scene;
    const Intersection found = intersection_of_pair(scene, pair, f);
    if (!found.exists) return;
    float gain = motion_by_nearness(found, pair) * color_difference(call, pair, found.t >= 0.5f);
    gain *= border_weight(scene, found, pair);
    const vec3* v = scene.corners(pair.image, f);
    for (int k = 0; k < 3; ++k) to[k] += nearness_by_corner(scene, found, v, k, gain);
}

// ---- Kernels ----

// Process the pixels of one face of one image. Another task processes the other face of an intersection.
NR_FUNC void intersect_face(const Intersections& call, int task) {
    const Scene& scene = call.scene;
    const int image = task / scene.count, f = task % scene.count;
    const vec3* v = scene.corners(image, f);
    if (!call.candidates[task] || !has_gradient(v, scene.perspective)) return;
    const Box box = pixel_box(v, 1, scene);
    vec3 to[3] = {};
    for (int j = box.bottom; j <= box.top; ++j) {
        const int* shown = scene.face_index + scene.row_start(image, j);
        for (int i = box.left; i <= box.right; ++i) {
            if (shown[i] != f) continue;
            for (int side = 0; side < 4; ++side) add_pair(call, PixelPair(image, i, j, side), f, to);
        }
    }
    for (int k = 0; k < 3; ++k) call.to_faces[(int64)task * 3 + k] += to[k];
}

// Add the gradient to face f, visible at the first pixel of a pair, with atomics.
NR_FUNC void add_pair_atomically(const Intersections& call, const PixelPair& pair, int f) {
    if (!has_gradient(call.scene.corners(pair.image, f), call.scene.perspective)) return;
    vec3 to[3] = {};
    add_pair(call, pair, f, to);
    for (int k = 0; k < 3; ++k) atomic_add(call.to_faces + ((int64)pair.image * call.scene.count + f) * 3 + k, to[k]);
}

// Pair the pixels of a task with their neighbours to the right and below, on CUDA.
NR_FUNC void intersect_pairs(const Intersections& call, int task) {
    const Scene& scene = call.scene;
    const Pixels pixels = pixels_of_task(task, call.each, scene.images * scene.height, scene.width);
    for (int line = pixels.first; line < pixels.last; ++line)
        for_each_pair(scene, line, pixels, true, [&](int image, int i, int row, bool down) {
            const PixelPair pair(image, i, scene.height - 1 - row, 3 * down);  // to the right, and below
            const int f = scene.face_index[(int64)line * scene.width + i], other = pair.second_face(scene);
            if (!may_meet(call, image, f, other, i, row, down)) return;
            add_pair_atomically(call, pair, f);
            add_pair_atomically(call, PixelPair(image, pair.i2, pair.j2, 1 + down), other);  // left, and above
        });
}

// The tangents of images for several tangents of the corners: the transpose of `intersect_face`.
struct IntersectionsForward {
    Intersections intersections;
    const vec3* motion;  // of the corners, [directions, images, count, 3]
    int directions;
    int atomic;     // whether tasks write to the same pixels concurrently
    float* images;  // [directions, images, channels, height, width] or halved; added to
};

// Add the change by face f, visible at the first pixel of a pair, to the pixel that contains the intersection, if that
// lies in one of ``lines``, which count from the top.
NR_FUNC void pair_forward(const IntersectionsForward& forward, const PixelPair& pair, int f, const Pixels& lines) {
    NR_UNFUSED
    const Intersections& call = forward.intersections;
    const Scene& scene = call.scene;
    const vec3* v = scene.corners(pair.image, f);
    if (!has_gradient(v, scene.perspective)) return;
    const Intersection found = intersection_of_pair(scene, pair, f);
    if (!found.exists) return;
    const int i = found.t < 0.5f ? pair.i : pair.i2, j = found.t < 0.5f ? pair.j : pair.j2;
    const int line = (pair.image + 1) * scene.height - 1 - j;
    if (line < lines.first || line >= lines.last) return;
    const Lines rows(0, scene, call.pictures, call.adjacent, pair.image);
    const int64 first = rows.pixel(pair.j, pair.i), second = rows.pixel(pair.j2, pair.i2);
    const int64 size = rows.channels * rows.grad_area;
    float* to = forward.images + pair.image * size + rows.grad_index(j, i);
    const float weight = border_weight(scene, found, pair) * rows.share_of_pixel();
    const float gain = motion_by_nearness(found, pair) * weight;
    for (int t = 0; t < forward.directions; ++t, to += scene.images * size) {
        const vec3* by = forward.motion + (((int64)t * scene.images + pair.image) * scene.count + f) * 3;
        float change = 0.0f;
        for (int k = 0; k < 3; ++k) change += dot(nearness_by_corner(scene, found, v, k, gain), by[k]);
        for (int c = 0; c < rows.channels; ++c)
            atomic_add(to + c * rows.grad_area, change * (rows.value(c, first) - rows.value(c, second)));
    }
}

// Pair the pixels of a task with their neighbours to the right and below. On the CPU a task writes only to its own
// rows, so it also reads the pairs with the row above.
NR_FUNC void pairs_forward(const IntersectionsForward& forward, int task) {
    const Intersections& call = forward.intersections;
    const Scene& scene = call.scene;
    const Pixels pixels = pixels_of_task(task, call.each, scene.images * scene.height, scene.width);
    const Pixels lines = forward.atomic ? Pixels{0, scene.images * scene.height, 0, 0} : pixels;
    for (int line = forward.atomic || pixels.first == 0 ? pixels.first : pixels.first - 1; line < pixels.last; ++line)
        for_each_pair(scene, line, pixels, line >= pixels.first, [&](int image, int i, int row, bool down) {
            const PixelPair pair(image, i, scene.height - 1 - row, 3 * down);
            const int f = scene.face_index[(int64)line * scene.width + i], other = pair.second_face(scene);
            if (!may_meet(call, image, f, other, i, row, down)) return;
            pair_forward(forward, pair, f, lines);
            pair_forward(forward, PixelPair(image, pair.i2, pair.j2, 1 + down), other, lines);
        });
}

}  // namespace nr
