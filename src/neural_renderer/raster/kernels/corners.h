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
        return vertex(indices + (broadcast(b, images) * (int64)count + f) * 3, k);
    }

    // The same of a face whose three indices are there.
    NR_FUNC int vertex(const int* face, int k) const {
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
    const int b = call.tasks.image(task), begin = call.tasks.begin(task), count = call.triangles.count;
    const int* indices = call.triangles.indices + (broadcast(b, call.triangles.images) * (int64)count + begin) * 3;
    float* vertices = call.vertices + (int64)b * call.triangles.vertices * call.channels;
    float* corner = call.corners + ((int64)b * count + begin) * 3 * call.channels;
    // Indices that are read once, and a constant number of channels, so that loops are unrolled, halve the time.
    const auto over_faces = [&](int channels) {
        for (int f = call.tasks.end(task, count) - begin; f > 0; --f, indices += 3) {
            const int face[3] = {indices[0], indices[1], indices[2]};
            for (int k = 0; k < 3; ++k, corner += channels) {
                const int i = call.triangles.vertex(face, k);
                each(i < 0 ? nullptr : vertices + (int64)i * channels, corner, channels);
            }
        }
    };
    if (call.channels == 3) over_faces(3);
    else over_faces(call.channels);
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
