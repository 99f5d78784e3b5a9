// The corners of faces, from vertices that they share, and the sum of the corners' gradients at the vertices.
#pragma once

#include "platform.h"

namespace nr {

// The faces of meshes by the numbers of their vertices.
struct Triangles {
    const int* indices;  // [images, count, 3]; (-1, -1, -1) is padding
    int images;          // 1 where all share them
    int count;           // faces of a mesh
    int vertices;        // vertices of a mesh

    // The vertex of corner k of face f in image b; that of padding is 0. -1 for a number out of range.
    NR_FUNC int vertex(int b, int64 f, int k) const {
        const int* face = indices + (shared(b, images) * (int64)count + f) * 3;
        const int i = (face[0] & face[1] & face[2]) == -1 ? 0 : face[k];
        return i >= 0 && i < vertices ? i : -1;
    }
};

// Tasks of ``each`` vertices or faces, of which an image has ``groups``.
struct Groups {
    int groups, each;

    NR_FUNC int image(int task) const { return task / groups; }
    NR_FUNC int group(int task) const { return task % groups; }
    NR_FUNC int begin(int task) const { return group(task) * each; }
    NR_FUNC int end(int task, int count) const { return smaller(begin(task) + each, count); }
};

struct GatherCorners {
    Triangles triangles;
    Groups tasks;
    int channels;
    float* vertices;  // [images, vertices, channels]; gradients are written
    float* corners;   // [images, count, 3, channels]
};

// Call each(vertex, corner) for the numbers of each corner of a task's faces; the vertex is null where there is none.
template <class Each>
NR_FUNC void over_corners(const GatherCorners& call, int task, Each each) {
    const Triangles& triangles = call.triangles;
    const int b = call.tasks.image(task), channels = call.channels;
    for (int64 f = call.tasks.begin(task), end = call.tasks.end(task, triangles.count); f < end; ++f) {
        for (int k = 0; k < 3; ++k) {
            const int i = triangles.vertex(b, f, k);
            float* vertex = i < 0 ? nullptr : call.vertices + ((int64)b * triangles.vertices + i) * channels;
            float* corner = call.corners + (((int64)b * triangles.count + f) * 3 + k) * channels;
            if (channels == 3) each(vertex, corner, 3);  // a constant, so that the loop is unrolled
            else each(vertex, corner, channels);
        }
    }
}

NR_FUNC void gather_corners(const GatherCorners& call, int task) {
    over_corners(call, task, [](const float* vertex, float* corner, int channels) {
        for (int c = 0; c < channels; ++c) corner[c] = vertex ? vertex[c] : NAN;
    });
}

// A CPU task has all faces of an image, because additions of several tasks would collide.
NR_FUNC void gather_corners_backward(const GatherCorners& call, int task) {
    over_corners(call, task, [](float* vertex, const float* corner, int channels) {
        for (int c = 0; vertex && c < channels; ++c) atomic_add(vertex + c, corner[c]);
    });
}

}  // namespace nr
