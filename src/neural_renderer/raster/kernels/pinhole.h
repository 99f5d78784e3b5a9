// Projection by cameras without distortion, and its gradient.
#pragma once

#include "corners.h"

namespace nr {

constexpr float LEAST_DEPTH = 1.0e-6f;  // smallest |z| in the division of x and y by z, in world units
constexpr int CAMERA_SUMS = 13;         // numbers of a gradient to a camera: rotation, origin and width

// Vertices and cameras. Tensors with one image are shared by all images.
struct View {
    const float* vertices;  // positions in the world, [images, count, 3]
    const float* rotation;  // the cameras' axes as rows, [images, 3, 3]
    const float* origin;    // the cameras' positions, [images, 3]
    // Tangent of half the field of view, or, without perspective, screen units per world unit, [images].
    const float* width;
    int meshes, rotations, origins, widths;  // images of each tensor above
    int count;                               // vertices of a mesh
    float aspect;                            // width / height of the image
    int perspective;
};

// The camera of one image.
struct Pinhole {
    const float *r, *o, *vertices;
    float across, aspect;
    bool perspective;

    NR_FUNC Pinhole(const View& view, int b)
        : r(view.rotation + (int64)broadcast(b, view.rotations) * 9),
          o(view.origin + (int64)broadcast(b, view.origins) * 3),
          vertices(view.vertices + (int64)broadcast(b, view.meshes) * view.count * 3),
          across(view.width[broadcast(b, view.widths)]),
          aspect(view.aspect),
          perspective(view.perspective) {}
};

// A vertex projected by a camera.
struct Projected {
    float dx, dy, dz;  // vector from the camera, in the world
    float x, y, z;     // coordinates along the camera's axes
    float near;        // z, no smaller than LEAST_DEPTH
    bool on_plane;     // whether the vertex lies on the camera's plane
    float sx, sy;      // position on the screen

    NR_FUNC Projected(const Pinhole& camera, int64 i) {
        const float *v = camera.vertices + 3 * i, *o = camera.o, *r = camera.r;
        dx = v[0] - o[0], dy = v[1] - o[1], dz = v[2] - o[2];
        x = dx * r[0] + dy * r[1] + dz * r[2];
        y = dx * r[3] + dy * r[4] + dz * r[5];
        z = dx * r[6] + dy * r[7] + dz * r[8];
        on_plane = fabsf(z) < LEAST_DEPTH;
        near = on_plane ? (z < 0.0f ? -LEAST_DEPTH : LEAST_DEPTH) : z;
        sx = (camera.perspective ? x / near / camera.across : x * camera.across) / camera.aspect;
        sy = camera.perspective ? y / near / camera.across : y * camera.across;
    }
};

// The gradient to a vertex, from the gradient g to its position (x, y, depth) on the screen.
struct ProjectedGradient {
    float along;                // g . (sx, sy): derivative by the logarithm of the distance, negated
    float to_x, to_y, to_z;     // gradient along the camera's axes
    float to_dx, to_dy, to_dz;  // gradient in the world

    NR_FUNC ProjectedGradient(const Pinhole& camera, const Projected& at, const float* g) {
        const float gx = g[0], gy = g[1], *r = camera.r;
        along = gx * at.sx + gy * at.sy;
        to_x = (camera.perspective ? gx / at.near / camera.across : gx * camera.across) / camera.aspect;
        to_y = camera.perspective ? gy / at.near / camera.across : gy * camera.across;
        to_z = g[2] - (camera.perspective && !at.on_plane ? along / at.near : 0.0f);
        to_dx = to_x * r[0] + to_y * r[3] + to_z * r[6];
        to_dy = to_x * r[1] + to_y * r[4] + to_z * r[7];
        to_dz = to_x * r[2] + to_y * r[5] + to_z * r[8];
    }
};

struct Project {
    View view;
    Groups tasks;
    float* screen;  // x, y on the screen and the depth, [images, count, 3]
};

NR_FUNC void project_vertices(const Project& call, int task) {
    const int b = call.tasks.image(task), count = call.view.count;
    const Pinhole camera(call.view, b);
    float* to = call.screen + (int64)b * count * 3;
    for (int i = call.tasks.begin(task), end = call.tasks.end(task, count); i < end; ++i) {
        const Projected at(camera, i);
        to[3 * i] = at.sx, to[3 * i + 1] = at.sy, to[3 * i + 2] = at.z;
    }
}

struct ProjectBackward {
    View view;
    Groups tasks;       // groups of each mesh in ``to_vertices``
    const float* grad;  // gradient to the screen, [images, count, 3]
    int images;
    int targets;         // meshes in ``to_vertices``; fewer than images where a task sums over the images
    float* to_vertices;  // [targets, count, 3]; written
    float* sums;         // gradients to rotation, origin and width, [images, groups, CAMERA_SUMS]; null if not wanted
};

// Compute the gradients of a group of vertices in image b; added to those of earlier images if ``add``.
NR_FUNC void project_group_backward(const ProjectBackward& call, int b, int task, bool add) {
    const int count = call.view.count, target = call.tasks.image(task);
    const Pinhole camera(call.view, b);
    const float* all = call.grad + (int64)b * count * 3;
    float* to = call.to_vertices + (int64)target * count * 3;
    double sum[CAMERA_SUMS] = {};
    for (int i = call.tasks.begin(task), end = call.tasks.end(task, count); i < end; ++i) {
        const Projected at(camera, i);
        const float* g = all + 3 * i;
        const ProjectedGradient by(camera, at, g);
        if (add) to[3 * i] += by.to_dx, to[3 * i + 1] += by.to_dy, to[3 * i + 2] += by.to_dz;
        else to[3 * i] = by.to_dx, to[3 * i + 1] = by.to_dy, to[3 * i + 2] = by.to_dz;
        if (!call.sums) continue;
        sum[0] += by.to_x * at.dx, sum[1] += by.to_x * at.dy, sum[2] += by.to_x * at.dz;
        sum[3] += by.to_y * at.dx, sum[4] += by.to_y * at.dy, sum[5] += by.to_y * at.dz;
        sum[6] += by.to_z * at.dx, sum[7] += by.to_z * at.dy, sum[8] += by.to_z * at.dz;
        sum[9] -= by.to_dx, sum[10] -= by.to_dy, sum[11] -= by.to_dz;
        sum[12] += camera.perspective ? -by.along / camera.across : g[0] * at.x / camera.aspect + g[1] * at.y;
    }
    float* whole = call.sums + ((int64)b * call.tasks.groups + call.tasks.group(task)) * CAMERA_SUMS;
    for (int k = 0; k < CAMERA_SUMS && call.sums; ++k) whole[k] = (float)sum[k];
}

NR_FUNC void project_vertices_backward(const ProjectBackward& call, int task) {
    const int image = call.tasks.image(task);
    if (call.targets == call.images) return project_group_backward(call, image, task, false);
    for (int b = 0; b < call.images; ++b) project_group_backward(call, b, task, b > 0);
}

// Projection of face corners, one face for each CUDA thread; vertices of several faces are projected several times.
struct ProjectCorners {
    View view;
    Triangles triangles;
    float* corners;      // x, y on the screen and the depth, [images, count, 3, 3]; in the backward pass their gradient
    float* to_vertices;  // gradient, [meshes, vertices, 3]; backward pass only
};

// Call each(camera, vertex, corner) for the corners of a task's face.
template <class Each>
NR_FUNC void over_projected(const ProjectCorners& call, int task, Each each) {
    const int b = task / call.triangles.count, f = task % call.triangles.count;
    const Pinhole camera(call.view, b);
    for (int k = 0; k < 3; ++k)
        each(b, camera, call.triangles.vertex(b, f, k), call.corners + ((int64)task * 3 + k) * 3);
}

NR_FUNC void project_corners(const ProjectCorners& call, int task) {
    over_projected(call, task, [](int, const Pinhole& camera, int i, float* corner) {
        if (i < 0) {
            for (int c = 0; c < 3; ++c) corner[c] = NAN;
        } else {
            const Projected at(camera, i);
            corner[0] = at.sx, corner[1] = at.sy, corner[2] = at.z;
        }
    });
}

NR_FUNC void project_corners_backward(const ProjectCorners& call, int task) {
    over_projected(call, task, [&call](int b, const Pinhole& camera, int i, const float* corner) {
        if (i < 0) return;
        const ProjectedGradient by(camera, Projected(camera, i), corner);
        const int64 mesh = broadcast(b, call.view.meshes);
        float* to = call.to_vertices + (mesh * call.view.count + i) * 3;
        atomic_add(to, by.to_dx), atomic_add(to + 1, by.to_dy), atomic_add(to + 2, by.to_dz);
    });
}

}  // namespace nr
