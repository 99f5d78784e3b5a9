// Attributes of vertices, interpolated at pixels with the weights of `clip.h`; their change between pixels; the
// gradient.
#pragma once

#include "clip.h"

namespace nr {

struct Attributes {
    const float* values;   // at the vertices, [owners, vertices, channels]
    const int* triangles;  // [count, 3]
    const float* rast;     // as from `show_triangles`, [images, height, width, 4]
    const float* changes;  // of the weights, as ``rast``; null if not needed
    const int* chosen;     // channels whose change is computed, [changing]; null for the first ones
    int owners;            // 1 where all images share the values
    int vertices, channels, changing;
    int count;  // triangles
    int images, height, width;
    int each;  // rows of a task

    NR_FUNC int64 start(int row) const { return (int64)broadcast(row / height, owners) * vertices * channels; }
    NR_FUNC int channel(int n) const { return chosen ? chosen[n] : n; }
    // The vertices of the triangle that a pixel shows; null for none.
    NR_FUNC const int* corners(int64 pixel) const {
        const int f = shown_triangle(rast + pixel * 4, count);
        if (f < 0) return nullptr;
        const int* corner = triangles + (int64)f * 3;
        for (int k = 0; k < 3; ++k)
            if (corner[k] < 0 || corner[k] >= vertices) return nullptr;
        return corner;
    }
};

struct InterpolateAttributes {
    Attributes of;
    float* result;             // [images, height, width, channels], 0 where there is no triangle
    float* changes_of_result;  // change of each chosen channel by one pixel, right and up, [..., 2 changing]
};

// The pixels of a task.
NR_FUNC void interpolate_attributes(const InterpolateAttributes& call, int task) {
    const Attributes& of = call.of;
    const int channels = of.channels;
    const Pixels pixels = pixels_of_task(task, of.each, of.images * of.height, of.width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) {
            const int64 pixel = (int64)row * of.width + i;
            float* result = call.result + pixel * channels;
            float* to = call.changes_of_result + pixel * 2 * of.changing;
            const int* corner = of.corners(pixel);
            if (!corner) {
                for (int c = 0; c < channels; ++c) result[c] = 0.0f;
                for (int n = 0; n < 2 * of.changing; ++n) to[n] = 0.0f;
                continue;
            }
            const float* values = of.values + of.start(row);
            const float* from[3];
            for (int k = 0; k < 3; ++k) from[k] = values + (int64)corner[k] * channels;
            const float u = of.rast[pixel * 4], v = of.rast[pixel * 4 + 1], rest = 1.0f - u - v;
            for (int c = 0; c < channels; ++c) result[c] = u * from[0][c] + v * from[1][c] + rest * from[2][c];
            const float* d = of.changes + pixel * 4;
            for (int n = 0; n < of.changing; ++n) {
                const int c = of.channel(n);
                const float by_u = from[0][c] - from[2][c], by_v = from[1][c] - from[2][c];
                to[2 * n] = d[0] * by_u + d[2] * by_v, to[2 * n + 1] = d[1] * by_u + d[3] * by_v;
            }
        }
}

struct InterpolateAttributesBackward {
    Attributes of;
    const float* grad;             // of ``result``
    const float* grad_of_changes;  // of ``changes_of_result``
    int values_too;                // whether the gradient to values is needed
    float* to_values;              // [owners, vertices, channels], 0 before
    float* to_rast;                // [images, height, width, 4]
    float* to_changes;             // as ``to_rast``; null if ``changes`` is
};

// The pixels of a task. On the CPU one task has all pixels that share values.
NR_FUNC void interpolate_attributes_backward(const InterpolateAttributesBackward& call, int task) {
    const Attributes& of = call.of;
    const int channels = of.channels;
    const Pixels pixels = pixels_of_task(task, of.each, of.images * of.height, of.width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) {
            const int64 pixel = (int64)row * of.width + i, start = of.start(row);
            const int* corner = of.corners(pixel);
            float to_u = 0.0f, to_v = 0.0f, to_changes[4] = {};
            if (corner) {
                const float* from[3];
                float* to[3];
                for (int k = 0; k < 3; ++k) {
                    const int64 at = start + (int64)corner[k] * channels;
                    from[k] = of.values + at, to[k] = call.values_too ? call.to_values + at : nullptr;
                }
                const float u = of.rast[pixel * 4], v = of.rast[pixel * 4 + 1], rest = 1.0f - u - v;
                const float* cotangent = call.grad + pixel * channels;
                for (int c = 0; c < channels; ++c) {
                    to_u += cotangent[c] * (from[0][c] - from[2][c]), to_v += cotangent[c] * (from[1][c] - from[2][c]);
                    if (!call.values_too) continue;
                    atomic_add(to[0] + c, u * cotangent[c]);
                    atomic_add(to[1] + c, v * cotangent[c]);
                    atomic_add(to[2] + c, rest * cotangent[c]);
                }
                const float* d = of.changes + pixel * 4;
                for (int n = 0; n < of.changing; ++n) {
                    const int c = of.channel(n);
                    const float right = call.grad_of_changes[(pixel * of.changing + n) * 2];
                    const float up = call.grad_of_changes[(pixel * of.changing + n) * 2 + 1];
                    const float by_u = from[0][c] - from[2][c], by_v = from[1][c] - from[2][c];
                    to_changes[0] += right * by_u, to_changes[1] += up * by_u;
                    to_changes[2] += right * by_v, to_changes[3] += up * by_v;
                    if (!call.values_too) continue;
                    const float first = right * d[0] + up * d[1], second = right * d[2] + up * d[3];
                    atomic_add(to[0] + c, first);
                    atomic_add(to[1] + c, second);
                    atomic_add(to[2] + c, -first - second);
                }
            }
            float* to_rast = call.to_rast + pixel * 4;
            to_rast[0] = to_u, to_rast[1] = to_v, to_rast[2] = to_rast[3] = 0.0f;
            for (int k = 0; call.to_changes && k < 4; ++k) call.to_changes[pixel * 4 + k] = to_changes[k];
        }
}

}  // namespace nr
