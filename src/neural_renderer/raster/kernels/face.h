// The visible point of a face at a pixel, its gradient to the corners, and loops over the pixels that show a face.
//
// With screen-space weights w_k, the depth is z = 1 / sum(w_k / z_k) and the weights in space are w_k z / z_k; in
// orthographic projection they are sum(w_k z_k) and w_k. Weights are equal to the bit on both devices: modules with
// these functions are compiled without fused multiply-adds.
#pragma once

#include "lanes.h"
#include "tasks.h"

namespace nr {

// Least area, relative to c^2, of a face with reliable weights from the inverse matrix; c is its largest coordinate in
// pixels. The weights are sums of products up to 2 c^2, whose rounding errors add up to about 82 * 2^-24 c^2.
constexpr float LEAST_AREA = 7.62939453125e-06f;  // 2^-17

// Barycentric weights by edge functions, as in `coverage`. At the pixels it drew, they have one sign and are not all 0.
NR_NOINLINE vec3 weights_by_edges(const vec3* v, float x, float y) {
    const vec3 w = {
        (v[1][0] - x) * (v[2][1] - y) - (v[1][1] - y) * (v[2][0] - x),
        (v[2][0] - x) * (v[0][1] - y) - (v[2][1] - y) * (v[0][0] - x),
        (v[0][0] - x) * (v[1][1] - y) - (v[0][1] - y) * (v[1][0] - x)};
    const float whole = w[0] + w[1] + w[2], third = 1.0f / 3.0f;
    if (whole == 0.0f) return {third, third, third};
    // Normalised first, because their products with 1 / z could overflow or underflow.
    return {w[0] / whole, w[1] / whole, w[2] / whole};
}

// A face, prepared for evaluating weights at pixels.
//
// The matrix maps a pixel (column, row from the bottom, 1) to its weights. It is 0 if edge functions are needed. The
// first packages computed weights by this inverse, and existing results contain its rounding errors: about 1e-4 of a
// weight for faces far smaller than a pixel.
struct Face {
    vec3 v[3];
    float matrix[9];
    float inverse[3];  // 1 / z of each corner in perspective, else 1
    bool front;        // whether it is in front of the camera; other visible faces cross the camera's plane
    bool known;        // whether the matrix gives weights
    int perspective, height, width, below;  // size of the whole image, and rows of it below the strip

    NR_FUNC void set(const vec3* corners, const Scene& scene) {
        perspective = scene.perspective, height = scene.whole_height(), width = scene.width, below = scene.below;
        float x[3], y[3], far = 0.0f;
        for (int k = 0; k < 3; ++k) {
            v[k] = corners[k];
            x[k] = to_pixels(v[k][0], width), y[k] = to_pixels(v[k][1], height);
            far = max(far, max(fabsf(x[k]), fabsf(y[k])));
            inverse[k] = perspective ? 1.0f / v[k][2] : 1.0f;
        }
        front = (perspective == 0) | ((v[0][2] > 0.0f) & (v[1][2] > 0.0f) & (v[2][2] > 0.0f));
        const float area = x[2] * (y[0] - y[1]) + x[0] * (y[1] - y[2]) + x[1] * (y[2] - y[0]);
        known = fabsf(area) > LEAST_AREA * far * far;
        const float part = known ? 1.0f / area : 0.0f;
        for (int k = 0; k < 3; ++k) {
            const int m = (k + 1) % 3, n = (k + 2) % 3;
            matrix[3 * k] = (y[m] - y[n]) * part;
            matrix[3 * k + 1] = (x[n] - x[m]) * part;
            matrix[3 * k + 2] = (x[m] * y[n] - x[n] * y[m]) * part;
        }
    }
    // Whether `Point::by_matrix` is valid for the face, so that several pixels are evaluated together.
    NR_FUNC bool is_usual() const { return front & known; }
};

// The visible point of a face at a pixel, or at neighbouring pixels of a row.
template <class F>
struct Point {
    typedef typename Lanes<F>::Mask Mask;
    F weights[3];   // weights in space; their sum is 1
    F w[3], whole;  // weights on the screen, w / whole
    F z;            // depth

    // Compute the points by the face's matrix, for pixels x of row y. The result is true where the matrix fails.
    NR_FUNC Mask by_matrix(const Face& face, F x, float y) {
        for (int k = 0; k < 3; ++k) {
            const F share = x * face.matrix[3 * k] + face.matrix[3 * k + 1] * y + face.matrix[3 * k + 2];
            w[k] = select(share < 0.0f, all<F>(0.0f), select(share > 1.0f, all<F>(1.0f), share));
        }
        whole = w[0] + w[1] + w[2];
        const Mask lost = whole == 0.0f;
        // Avoid 0 / 0 in these lanes, because NaN times 0 is NaN.
        w[0] = select(lost, all<F>(1.0f), w[0]), whole = select(lost, all<F>(1.0f), whole);
        into_space(face);
        return lost;
    }
    // Weights in space and depth from the weights on the screen.
    NR_FUNC void into_space(const Face& face) {
        if (face.perspective) {
            for (int k = 0; k < 3; ++k) weights[k] = w[k] * face.inverse[k];
            const F near = 1.0f / (weights[0] + weights[1] + weights[2]);
            for (int k = 0; k < 3; ++k) weights[k] *= near;
            z = whole * near;
        } else {
            const F part = 1.0f / whole;
            for (int k = 0; k < 3; ++k) weights[k] = w[k] * part;
            z = weights[0] * face.v[0][2] + weights[1] * face.v[1][2] + weights[2] * face.v[2][2];
        }
    }
};

// The visible point at pixel i of row j from the bottom, for any face.
NR_FUNC Point<float> point_at(const Face& face, int i, int j) {
    Point<float> point;
    j += face.below;
    if (!face.front) {
        const vec3d a = homogeneous_weights(face.v, pixel_centre(i, face.width), pixel_centre(j, face.height));
        const double sum = a[0] + a[1] + a[2];
        for (int k = 0; k < 3; ++k) {
            point.weights[k] = (float)(a[k] / sum), point.w[k] = (float)(a[k] * (double)face.v[k][2]);
        }
        point.whole = 1.0f, point.z = (float)(1.0 / sum);
    } else if (point.by_matrix(face, (float)i, (float)j)) {
        const vec3 w = weights_by_edges(face.v, pixel_centre(i, face.width), pixel_centre(j, face.height));
        for (int k = 0; k < 3; ++k) point.w[k] = w[k];
        point.whole = w[0] + w[1] + w[2];
        point.into_space(face);
    }
    return point;
}

// The gradient of a face's barycentric weights on the screen; 0 for a `degenerate` face, where rounding hides it.
struct Slopes {
    float dx[3], dy[3];

    Slopes() = default;
    NR_FUNC explicit Slopes(const Face& face) {
        float longest = 0.0f;
        for (int k = 0; k < 3; ++k) {
            const vec3 &a = face.v[(k + 1) % 3], &b = face.v[(k + 2) % 3];
            dx[k] = a[1] - b[1], dy[k] = b[0] - a[0];
            longest = max(longest, max(fabsf(dx[k]), fabsf(dy[k])));
        }
        const float area = doubled_area(face.v);
        const float part = fabsf(area) > NARROWEST * longest ? 1.0f / area : 0.0f;
        for (int k = 0; k < 3; ++k) dx[k] *= part, dy[k] *= part;
    }
};

// The sum of the gradients of a face's pixels to its corners.
template <class F>
struct CornerSums {
    typedef typename Lanes<F>::Mask Mask;
    F to[9];

    NR_FUNC CornerSums() {
        for (int k = 0; k < 9; ++k) to[k] = all<F>(0.0f);
    }
    // Add the pixels of the mask ``here``. The gradients of the others must be finite.
    //
    // At a fixed pixel, moving corner m by s on the screen changes the weight w_k by -w_m grad(w_k) . s. In
    // perspective, depth and the weights in space are computed from w_k / z_k, whose sum is 1 / depth.
    NR_FUNC void add(
        const Face& face, const Slopes& slopes, const Point<F>& point, const F* to_weights, F to_depth, Mask here) {
        const F part = 1.0f / point.whole;
        const F same = to_weights[0] * point.weights[0] + to_weights[1] * point.weights[1]
            + to_weights[2] * point.weights[2] + point.z * to_depth;
        F right = all<F>(0.0f), up = all<F>(0.0f), g[3];
        for (int k = 0; k < 3; ++k) {
            g[k] = face.perspective ? point.z * (to_weights[k] - same) * face.inverse[k]
                                    : to_weights[k] + to_depth * face.v[k][2];
            right += g[k] * slopes.dx[k], up += g[k] * slopes.dy[k];
        }
        for (int k = 0; k < 3; ++k) {
            const F share = select(here, point.w[k] * part, all<F>(0.0f));
            to[3 * k] -= right * share;
            to[3 * k + 1] -= up * share;
            to[3 * k + 2] += share * (face.perspective ? -g[k] * face.inverse[k] : to_depth);
        }
    }
    // Add the gradient of interpolated attributes, summed over pixels. ``relative``: attributes of the corners minus
    // those of the first corner, [3, channels], because a common offset has no gradient. ``cotangents``: sums of
    // weights[k] * cotangent, [3, channels]. ``colors``: in perspective, sums of weights[k] * (interpolated
    // ``relative``) * cotangent.
    template <int CHANNELS, class G>
    NR_FUNC void add_attributes(
        const Face& face, const Slopes& slopes, const float* relative, const float* cotangents, const G* colors,
        int channels = CHANNELS) {
        float right[CHANNELS] = {}, up[CHANNELS] = {}, all_right = 0.0f, all_up = 0.0f;  // slopes of channels, of 1
        for (int k = 0; k < 3; ++k) {
            const float dx = face.inverse[k] * slopes.dx[k], dy = face.inverse[k] * slopes.dy[k];
            all_right += dx, all_up += dy;
            for (int c = 0; c < channels; ++c)
                right[c] += relative[k * channels + c] * dx, up[c] += relative[k * channels + c] * dy;
        }
        for (int k = 0; k < 3; ++k) {
            const float of_color = sum(colors[k]), z = face.perspective ? face.v[k][2] : 1.0f;
            float to_x = -all_right * of_color, to_y = -all_up * of_color, to_near = -of_color;
            for (int c = 0; c < channels; ++c) {
                const float part = cotangents[k * channels + c];
                to_x += right[c] * part, to_y += up[c] * part, to_near += relative[k * channels + c] * part;
            }
            to[3 * k] -= to_x * z;
            to[3 * k + 1] -= to_y * z;
            if (face.perspective) to[3 * k + 2] -= to_near * face.inverse[k];
        }
    }
    // Add the sums of a vector over its lanes.
    template <class G>
    NR_FUNC void add(const CornerSums<G>& other) {
        for (int k = 0; k < 9; ++k) to[k] += sum(other.to[k]);
    }
    // Write the sums to the corners if ``exclusive``: no other task writes them; otherwise add atomically.
    NR_FUNC void give(vec3* corners, bool exclusive) const {
        for (int k = 0; k < 3; ++k) {
            const vec3 part = {to[3 * k], to[3 * k + 1], to[3 * k + 2]};
            if (exclusive) corners[k] = part;
            else atomic_add(corners + k, part);
        }
    }
};

// The change of a point if the corners of its face move by ``by`` (its tangent): the transpose of `CornerSums::add`.
template <class F>
struct PointChange {
    F weights[3], z;  // of the weights in space, and the depth

    NR_FUNC PointChange(const Face& face, const Slopes& slopes, const Point<F>& point, const vec3* by) {
        const F part = 1.0f / point.whole;
        F share[3], right = all<F>(0.0f), up = all<F>(0.0f), sum = all<F>(0.0f);
        for (int k = 0; k < 3; ++k) {
            share[k] = point.w[k] * part;
            right += share[k] * by[k][0], up += share[k] * by[k][1];
        }
        z = all<F>(0.0f);
        for (int k = 0; k < 3; ++k) {
            weights[k] = -right * slopes.dx[k] - up * slopes.dy[k];
            if (face.perspective) {
                weights[k] = point.z * face.inverse[k] * (weights[k] - share[k] * face.inverse[k] * by[k][2]);
                sum += weights[k];
            } else z += weights[k] * face.v[k][2] + share[k] * by[k][2];
        }
        if (!face.perspective) return;
        for (int k = 0; k < 3; ++k) weights[k] -= point.weights[k] * sum;
        z = -point.z * sum;
    }
};

// Tangents of the corners in several directions.
struct Motion {
    const vec3* corners;  // [directions, images, count, 3]
    int directions;
    int each;  // rows of a task
};

// A pixel that a loop visits: column i, row j from the bottom, and its offset in a map [images, H, W].
struct Place {
    int image, face, i, j;
    int64 pixel;
};

// Visit the pixels of a task of rows (see `pixels_of_task`), from left to right.
//
// ``Extra`` holds the kernel's own per-face data. The visitor has these methods:
//     fresh(face, place, extra)             a face that is not in the cache
//     one(face, point, place, extra)        a pixel that shows a face
//     run(face, points, count, place, extra)   count <= 8 neighbours that show one face, on the CPU. It may overwrite
//                                           the following pixels of the row, which are computed later
//     empty(count, place)                   neighbours without a face
template <class Extra, class Visitor>
NR_FUNC void over_rows(const Scene& scene, int task, int each, Visitor visitor) {
    constexpr int BITS = THREADS_ARE_LANES ? 0 : 7, KEPT = 1 << BITS;  // neighbouring rows show the same faces
    Face kept[KEPT];
    Extra extras[KEPT];
    int64 held[KEPT];
    for (int k = 0; k < KEPT; ++k) held[k] = -1;
    const int width = scene.width;
    const Pixels pixels = pixels_of_task(task, each, scene.images * scene.height, width);
    const int left = pixels.left, right = pixels.right;
    for (int row = pixels.first; row < pixels.last; ++row) {
        Place place = {row / scene.height, -1, 0, scene.height - 1 - row % scene.height, 0};
        const int* shown = scene.face_index + (int64)row * width;
        for (int i = left; i < right; ++i) {
            const int f = shown[i];
            place.face = f, place.i = i, place.pixel = (int64)row * width + i;
            if (f < 0) {  // most pixels of most images, so several are skipped together
                int empty = 1;
#if NR_LANES
                for (int four[4]; i + empty + 4 <= right; empty += 4) {
                    memcpy(four, shown + i + empty, sizeof(four));
                    if ((four[0] & four[1] & four[2] & four[3]) >= 0) break;
                }
#endif
                while (i + empty < right && shown[i + empty] < 0) ++empty;
                visitor.empty(empty, place);
                i += empty - 1;
                continue;
            }
            const int64 number = (int64)place.image * scene.count + f;
            // Spread by Knuth's multiplicative hash: neighbours are often a multiple of a power of two apart.
            const int slot = (int)((uint64)((unsigned)f * 2654435761u) >> (32 - BITS));
            Face& face = kept[slot];
            if (held[slot] != number) {
                face.set(scene.faces + number * 3, scene);
                held[slot] = number;
                visitor.fresh(face, place, extras[slot]);
            }
#if NR_LANES
            if (face.is_usual() && width >= 8) {
                // The pixels up to the next face, at most eight; without a loop, whose end is hard to predict.
                const int at = min(i, width - 8);
                const int run = lowest_bit(~(uint64)(bits(load<ints8>(shown + at) == f) >> (i - at)));
                Point<floats8> points;
                const ints8 lost =
                    points.by_matrix(face, to_floats(lane_numbers<ints8>() + i), (float)(face.below + place.j));
                if (!any(lost & (lane_numbers<ints8>() < run))) {
                    visitor.run(face, points, run, place, extras[slot]);
                    i += run - 1;
                    continue;
                }
            }
#endif
            visitor.one(face, point_at(face, i, place.j), place, extras[slot]);
        }
    }
}

// Store tangents of results that depend on visible points, for the pixels of a task.
//
// ``change`` has these methods; points are those of a pixel, or on the CPU of ``count`` <= 8 neighbours of one face:
//     at(face, points, place)                  values that `store` needs in all directions
//     store(values, moved, t, count, place)    the tangent in direction t, from the `PointChange`
//     clear(t, count, place)                   neighbours without a face
template <class Change>
struct ChangedRows {
    const Scene& scene;
    const Motion& motion;
    const Change& change;

    NR_FUNC void fresh(const Face& face, const Place&, Slopes& slopes) const { slopes = Slopes(face); }
    NR_FUNC void empty(int count, const Place& place) const {
        for (int t = 0; t < motion.directions; ++t) change.clear(t, count, place);
    }
    NR_FUNC void one(const Face& face, const Point<float>& point, const Place& place, const Slopes& slopes) const {
        run(face, point, 1, place, slopes);
    }
    template <class F>
    NR_FUNC void run(
        const Face& face, const Point<F>& points, int count, const Place& place, const Slopes& slopes) const {
        const auto value = change.at(face, points, place);
        for (int t = 0; t < motion.directions; ++t) {
            const int64 image = (int64)t * scene.images + place.image;
            const PointChange<F> moved(face, slopes, points, motion.corners + (image * scene.count + place.face) * 3);
            change.store(value, moved, t, count, place);
        }
    }
};

template <class Change>
NR_FUNC void over_changes(const Scene& scene, const Motion& motion, int task, const Change& change) {
    over_rows<Slopes>(scene, task, motion.each, ChangedRows<Change>{scene, motion, change});
}

// Visit the pixels of a box that show face f of an image; on the CPU eight together if ``in_eights``.
//
// The visitor has these methods:
//     one(face, point, place)             a pixel
//     eight(face, points, place, here)    eight contiguous pixels; ``here`` masks those to visit
//     finish_eights(face)                 after all pixels, if ``eight`` may have been called
template <class Visitor>
NR_FUNC void over_face(
    const Scene& scene, const Face& face, int image, int f, const Box& box, bool in_eights, Visitor& visitor) {
    const int width = scene.width;
#if NR_LANES
    if (face.is_usual() && width >= 8 && in_eights) {
        for (int j = box.bottom; j <= box.top; ++j) {
            const int64 row = scene.row_start(image, j);
            for (int i = box.left; i <= box.right; i += 8) {
                const int at = i < width - 8 ? i : width - 8;
                __builtin_prefetch(scene.face_index + row + at - ROWS_AHEAD * width);
                const ints8 here = (load<ints8>(scene.face_index + row + at) == f) & (lane_numbers<ints8>() >= i - at);
                if (!any(here)) continue;
                Point<floats8> points;
                const ints8 lost =
                    points.by_matrix(face, to_floats(lane_numbers<ints8>() + at), (float)(face.below + j)) & here;
                visitor.eight(face, points, Place{image, f, at, j, row + at}, here & ~lost);
                if (!any(lost)) continue;
                for (int n = 0; n < 8; ++n)
                    if (lost[n]) visitor.one(face, point_at(face, at + n, j), Place{image, f, at + n, j, row + at + n});
            }
        }
        return visitor.finish_eights(face);
    }
#endif
    for (int j = box.bottom; j <= box.top; ++j) {
        const int64 row = scene.row_start(image, j);
        for (int i = box.left; i <= box.right; ++i) {
            if (scene.face_index[row + i] != f) continue;
            visitor.one(face, point_at(face, i, j), Place{image, f, i, j, row + i});
        }
    }
}

}  // namespace nr
