// The visible points of pixels, from vertices in clip space: weights, depth z / w and derivatives by pixel position.
//
// A vertex (x, y, z, w) lies at (x / w, y / w) on the screen, in [-1, 1] over the image. Images have row 0 at the
// bottom. For a pixel with its centre at (X, Y), p_k = (x_k - X w_k, y_k - Y w_k) is where corner k lies, times w_k,
// relative to the centre. With a_0 = p_1 x p_2 and so on, the weights in space are b_k = a_k / (a_0 + a_1 + a_2), for
// corners behind the camera, too (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997).
#pragma once

#include "tasks.h"

namespace nr {

// Triangles of B images, which share vertex indices.
struct ClipMesh {
    const float* positions;  // vertices (x, y, z, w), [owners, vertices, 4]
    const int* triangles;    // [count, 3]
    int owners;              // 1 where all images share the positions
    int vertices;            // vertices of an image
    int count;               // triangles
    int images, height, width;

    NR_FUNC int64 start(int image) const { return (int64)broadcast(image, owners) * vertices * 4; }
    // The vertex indices of a triangle; null if the triangle or one of its indices is out of range.
    NR_FUNC const int* corners(int f) const {
        if (f < 0 || f >= count) return nullptr;
        const int* corner = triangles + (int64)f * 3;
        for (int k = 0; k < 3; ++k)
            if (corner[k] < 0 || corner[k] >= vertices) return nullptr;
        return corner;
    }
};

// The visible triangle, by the fourth number of `rast`, which counts from 1; -1 for none.
NR_FUNC int shown_triangle(const float* rast, int count) {
    const float number = rast[3];
    return number >= 1.0f && number <= (float)count ? (int)number - 1 : -1;
}

// A triangle relative to the centre of a pixel.
struct TriangleAtPixel {
    float x[3], y[3], w[3];  // p_k, and w_k
    float a[3], whole;       // a_k, and their sum

    NR_FUNC TriangleAtPixel(const float* positions, const int* corner, float right, float up) {
        for (int k = 0; k < 3; ++k) {
            const float* at = positions + (int64)corner[k] * 4;
            w[k] = at[3], x[k] = at[0] - right * w[k], y[k] = at[1] - up * w[k];
        }
        whole = 0.0f;
        for (int k = 0; k < 3; ++k) {
            const int m = (k + 1) % 3, n = (k + 2) % 3;
            a[k] = x[m] * y[n] - x[n] * y[m];
            whole += a[k];
        }
    }
    NR_FUNC float weight(int k) const { return whole == 0.0f ? 1.0f / 3.0f : a[k] / whole; }
    // The derivative of a_k by the position of the pixel centre on the screen.
    NR_FUNC float slope_right(int k) const {
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        return y[m] * w[n] - y[n] * w[m];
    }
    NR_FUNC float slope_up(int k) const {
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        return x[n] * w[m] - x[m] * w[n];
    }
};

// The triangles that are drawn in each image: all, or those of a range.
struct DrawnTriangles {
    const int* ranges;  // first triangle and number of triangles of each image, [images, 2]; null for all
    int slots;          // most triangles of an image

    // The triangle of a slot; -1 for none.
    NR_FUNC int triangle(int image, int slot) const {
        if (!ranges) return slot;
        return slot < ranges[2 * image + 1] ? ranges[2 * image] + slot : -1;
    }
};

struct ShowTriangles {
    ClipMesh mesh;
    DrawnTriangles drawn;
    const int* face_index;  // drawn part of a triangle, part x slots + slot, -1 for none, [images, height, width]
    const int64* keys;      // in place of ``face_index``, on CUDA: these are their low bits
    int each;               // rows of a task
    float* rast;            // (weight of corner 0, weight of corner 1, z / w, triangle + 1), [images, height, width, 4]
    float* changes;         // change of both weights by one pixel, right and up in turn, as ``rast``
};

// The pixels of a task.
NR_FUNC void show_triangles(const ShowTriangles& call, int task) {
    const ClipMesh& mesh = call.mesh;
    const int height = mesh.height, width = mesh.width;
    const Pixels pixels = pixels_of_task(task, call.each, mesh.images * height, width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) {
            const int64 pixel = (int64)row * width + i;
            float *rast = call.rast + pixel * 4, *changes = call.changes + pixel * 4;
            const int drawn = call.keys ? (int)call.keys[pixel] : call.face_index[pixel];
            const int f = drawn < 0 ? -1 : call.drawn.triangle(row / height, drawn % call.drawn.slots);
            const int* corner = mesh.corners(f);
            if (!corner) {
                for (int k = 0; k < 4; ++k) rast[k] = changes[k] = 0.0f;
                continue;
            }
            const float* positions = mesh.positions + mesh.start(row / height);
            const TriangleAtPixel triangle(
                positions, corner, pixel_centre(i, width), pixel_centre(row % height, height));
            float z = 0.0f, w = 0.0f, right = 0.0f, up = 0.0f;
            for (int k = 0; k < 3; ++k) {
                z += triangle.weight(k) * positions[(int64)corner[k] * 4 + 2], w += triangle.weight(k) * triangle.w[k];
                right += triangle.slope_right(k), up += triangle.slope_up(k);
            }
            // The centre lies in the triangle, apart from rounding errors.
            rast[0] = clamp(triangle.weight(0), 0.0f, 1.0f), rast[1] = clamp(triangle.weight(1), 0.0f, 1.0f - rast[0]);
            rast[2] = clamp(z / w, -1.0f, 1.0f), rast[3] = (float)(f + 1);
            const float part = triangle.whole == 0.0f ? 0.0f : 2.0f / triangle.whole;
            for (int k = 0; k < 2; ++k) {
                changes[2 * k] = (triangle.slope_right(k) - triangle.weight(k) * right) * part / (float)width;
                changes[2 * k + 1] = (triangle.slope_up(k) - triangle.weight(k) * up) * part / (float)height;
            }
        }
}

struct ShowTrianglesBackward {
    ClipMesh mesh;
    const float* rast;             // as from `show_triangles`
    const float* grad;             // of ``rast``, [images, height, width, 4]
    const float* grad_of_changes;  // of ``changes``, as ``grad``; null if not needed
    int each;                      // rows of a task
    float* to_positions;           // [owners, vertices, 4], 0 before
};

// Add the gradient of a pixel's weights and their changes to (x, y, w) of the corners, [3, 3]: the formulas above in
// reverse, from b_k and its change to a_k and its slopes, then to p_k and w_k.
NR_FUNC void add_to_corners(
    const TriangleAtPixel& triangle, const float* grad, const float* grad_of_changes, const ClipMesh& mesh, float right,
    float up, float* to) {
    if (triangle.whole == 0.0f) return;
    const float part = 1.0f / triangle.whole;
    const float b[3] = {triangle.a[0] * part, triangle.a[1] * part, triangle.a[2] * part};
    float to_b[3] = {grad[0], grad[1], 0.0f}, to_whole = 0.0f;
    float to_right[3] = {}, to_up[3] = {};  // gradients of the slopes of a_k
    if (grad_of_changes) {
        float all_right = 0.0f, all_up = 0.0f, of_right = 0.0f, of_up = 0.0f;
        for (int k = 0; k < 3; ++k) all_right += triangle.slope_right(k), all_up += triangle.slope_up(k);
        for (int k = 0; k < 2; ++k) {
            const float c = grad_of_changes[2 * k] * 2.0f / (float)mesh.width * part;
            const float d = grad_of_changes[2 * k + 1] * 2.0f / (float)mesh.height * part;
            to_right[k] = c, to_up[k] = d;
            of_right += c * b[k], of_up += d * b[k];
            to_b[k] -= c * all_right + d * all_up;
            to_whole -=
                (c * (triangle.slope_right(k) - b[k] * all_right) + d * (triangle.slope_up(k) - b[k] * all_up)) * part;
        }
        for (int k = 0; k < 3; ++k) to_right[k] -= of_right, to_up[k] -= of_up;
    }
    float to_x[3] = {}, to_y[3] = {}, to_w[3] = {};
    const float same = to_b[0] * b[0] + to_b[1] * b[1];
    for (int k = 0; k < 3; ++k) {
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        const float to_a = (to_b[k] - same) * part + to_whole;
        to_x[m] += to_a * triangle.y[n] - to_up[k] * triangle.w[n],
            to_x[n] += to_up[k] * triangle.w[m] - to_a * triangle.y[m];
        to_y[m] += to_right[k] * triangle.w[n] - to_a * triangle.x[n],
            to_y[n] += to_a * triangle.x[m] - to_right[k] * triangle.w[m];
        to_w[m] += to_up[k] * triangle.x[n] - to_right[k] * triangle.y[n];
        to_w[n] += to_right[k] * triangle.y[m] - to_up[k] * triangle.x[m];
    }
    for (int k = 0; k < 3; ++k) {
        to[3 * k] += to_x[k], to[3 * k + 1] += to_y[k];
        to[3 * k + 2] += to_w[k] - right * to_x[k] - up * to_y[k];
    }
}

// Add gradients [3, 3] to (x, y, w) of a triangle's corners to those of its vertices.
NR_FUNC void give_to_vertices(const float* sums, const int* corner, float* to_positions) {
    for (int k = 0; corner && k < 3; ++k) {
        float* to = to_positions + (int64)corner[k] * 4;
        atomic_add(to, sums[3 * k]), atomic_add(to + 1, sums[3 * k + 1]), atomic_add(to + 3, sums[3 * k + 2]);
    }
}

// The pixels of a task. On the CPU one task has all pixels that share vertices. Neighbouring pixels that show the same
// triangle are summed first.
NR_FUNC void show_triangles_backward(const ShowTrianglesBackward& call, int task) {
    const ClipMesh& mesh = call.mesh;
    const int height = mesh.height, width = mesh.width;
    const Pixels pixels = pixels_of_task(task, call.each, mesh.images * height, width);
    for (int row = pixels.first; row < pixels.last; ++row) {
        const int64 start = mesh.start(row / height);
        const float up = pixel_centre(row % height, height);
        float sums[9] = {};
        int summed = -1;
        const int* corner = nullptr;
        for (int i = pixels.left; i < pixels.right; ++i) {
            const int64 pixel = (int64)row * width + i;
            const int f = shown_triangle(call.rast + pixel * 4, mesh.count);
            if (f != summed) {
                give_to_vertices(sums, corner, call.to_positions + start);
                corner = mesh.corners(f), summed = f;
                for (int k = 0; k < 9; ++k) sums[k] = 0.0f;
            }
            if (!corner) continue;
            const float right = pixel_centre(i, width);
            const float* changes = call.grad_of_changes ? call.grad_of_changes + pixel * 4 : nullptr;
            const TriangleAtPixel triangle(mesh.positions + start, corner, right, up);
            add_to_corners(triangle, call.grad + pixel * 4, changes, mesh, right, up, sums);
        }
        give_to_vertices(sums, corner, call.to_positions + start);
    }
}

}  // namespace nr
