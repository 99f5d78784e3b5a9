// Gathers face corners from shared vertices; the gradient scatters back to the vertices.
#pragma once

#include "platform.h"

namespace nr {

// The faces of meshes by their vertex indices.
struct Triangles {
    const int* indices;  // [images, count, 3]; (-1, -1, -1) is padding
    int images;          // 1 where all share them
    int count;           // faces of a mesh
    int vertices;        // vertices of a mesh

    // The vertex index of corner k of face f in image b: 0 for padding, -1 if the index is out of range.
    NR_FUNC int vertex(int b, int64 f, int k) const {
        const int* face = indices + (broadcast(b, images) * (int64)count + f) * 3;
        const int i = (face[0] & face[1] & face[2]) == -1 ? 0 : face[k];
        return i >= 0 && i < vertices ? i : -1;
    }
};

// Each image is divided into ``groups`` tasks of ``each`` vertices or faces.
struct Groups {
    int groups, each;

    NR_FUNC int image(int task) const { return task / groups; }
    NR_FUNC int group(int task) const { return task % groups; }
    NR_FUNC int begin(int task) const { return group(task) * each; }
    NR_FUNC int end(int task, int count) const { return min(begin(task) + each, count); }
};

struct GatherCorners {
    Triangles triangles;
    Groups tasks;
    int channels;
    float* vertices;  // [images, vertices, channels]; gradients are written
    float* corners;   // [images, count, 3, channels]
};

// Call each(vertex, corner, channels) for each corner of a task's faces; vertex is null for an index out of range.
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

// On the CPU one task has all faces of an image, because additions of several tasks would collide.
NR_FUNC void gather_corners_backward(const GatherCorners& call, int task) {
    over_corners(call, task, [](float* vertex, const float* corner, int channels) {
        for (int c = 0; vertex && c < channels; ++c) atomic_add(vertex + c, corner[c]);
    });
}

}  // namespace nr
