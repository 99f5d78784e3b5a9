// Ambient and directional light (Lambert's cosine law) on both sides of faces, and its gradient.
#pragma once

#include "corners.h"

namespace nr {

// Faces with larger coordinates are scaled down before their normals are computed.
constexpr float LARGEST_COORDINATE = 1.0e4f;
// A face whose area, relative to its squared longest edge, is smaller has a normal shorter than 1.
constexpr float SMALLEST_SINE = 1.0e-5f;
constexpr int LIGHT_SUMS = 9;  // numbers of a gradient to the light: ambient, directional and direction

// Meshes and lights. Tensors with one image are shared by all images.
struct LitScene {
    Triangles triangles;
    const float* vertices;     // positions in the world, [meshes, vertices, 3]
    const float* ambient;      // colour of the ambient light, [ambients, 3]
    const float* directional;  // colour of the directional light, [directionals, 3]
    const float* direction;    // direction towards the light, [directions, 3]
    int meshes, ambients, directionals, directions;
    int mirrored;  // whether the camera mirrors
};

// The light of one image.
struct ImageLight {
    const float *points, *glow, *beam, *towards;

    NR_FUNC ImageLight(const LitScene& scene, int b)
        : points(scene.vertices + (int64)broadcast(b, scene.meshes) * scene.triangles.vertices * 3),
          glow(scene.ambient + 3 * broadcast(b, scene.ambients)),
          beam(scene.directional + 3 * broadcast(b, scene.directionals)),
          towards(scene.direction + 3 * broadcast(b, scene.directions)) {}
};

// The normal n of a face, along (v0 - v1) x (v2 - v1), as `face_normals` computes it.
struct Normal {
    float p[3], q[3];  // edges from the second corner, scaled
    float scale;       // scale of the corners
    float n[3];
    float length, floor, part;  // n is divided by max(length, floor); part is the inverse
    float toward;               // n . direction
    float facing;               // toward, for side 0: the opposite normal unless the camera mirrors

    NR_FUNC Normal(const LitScene& scene, const ImageLight& light, int b, int f) {
        float largest = 0.0f, v[9], pp = 0.0f, qq = 0.0f;
        for (int k = 0; k < 3; ++k) {
            const int i = scene.triangles.vertex(b, f, k);
            for (int c = 0; c < 3; ++c) v[3 * k + c] = i < 0 ? NAN : light.points[3 * (int64)i + c];
        }
        for (int k = 0; k < 9; ++k) largest = max(fabsf(v[k]), largest);
        scale = largest > LARGEST_COORDINATE ? LARGEST_COORDINATE / largest : 1.0f;
        for (int k = 0; k < 3; ++k) {
            p[k] = (v[k] - v[3 + k]) * scale, q[k] = (v[6 + k] - v[3 + k]) * scale;
            pp += p[k] * p[k], qq += q[k] * q[k];
        }
        for (int k = 0; k < 3; ++k) n[k] = p[(k + 1) % 3] * q[(k + 2) % 3] - p[(k + 2) % 3] * q[(k + 1) % 3];
        length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        float edge = pp > qq ? pp : qq;
        edge = edge > 1.0f ? 1.0f : edge < 1.0e-12f ? 1.0e-12f : edge;
        floor = SMALLEST_SINE * edge, part = 1.0f / (length > floor ? length : floor);
        for (int k = 0; k < 3; ++k) n[k] *= part;
        toward = n[0] * light.towards[0] + n[1] * light.towards[1] + n[2] * light.towards[2];
        facing = scene.mirrored ? toward : -toward;
    }
};

struct FlatLight {
    LitScene scene;
    Groups tasks;
    float* factors;  // [images, 2, count, 3]; side 0 is that of (v1 - v0) x (v2 - v0), the other one if mirrored
};

NR_FUNC void light_faces(const FlatLight& call, int task) {
    const int b = call.tasks.image(task);
    const int64 all = call.scene.triangles.count;
    const ImageLight light(call.scene, b);
    float* to = call.factors + b * all * 6;
    NR_NO_VECTORS  // over faces: strided vectors would save little time and take a second to compile
        for (int f = call.tasks.begin(task), end = call.tasks.end(task, (int)all); f < end; ++f) {
        const Normal normal(call.scene, light, b, f);
        const float facing = normal.facing;
        const float front = facing > 0.0f ? facing : 0.0f, back = facing < 0.0f ? -facing : 0.0f;
        for (int k = 0; k < 3; ++k) {
            to[3 * f + k] = light.glow[k] + light.beam[k] * front;
            to[3 * (all + f) + k] = light.glow[k] + light.beam[k] * back;
        }
    }
}

struct FlatLightBackward {
    LitScene scene;
    Groups tasks;       // groups of each mesh in ``to_corners``
    const float* grad;  // [images, 2, count, 3]
    int images;
    int targets;         // meshes in ``to_corners``; fewer than images where a task sums over the images
    float* to_corners;   // [targets, count, 3, 3]; null if ``to_vertices`` is given
    float* to_vertices;  // [meshes, vertices, 3], 0 before; on CUDA
    float* sums;  // gradients to ambient, directional and direction, [images, groups, LIGHT_SUMS]; null if not wanted
};

// The gradients of a group of faces in image b, added to those of earlier images if ``add``.
NR_FUNC void light_group_backward(const FlatLightBackward& call, int b, int task, bool add) {
    const LitScene& scene = call.scene;
    const int64 all = scene.triangles.count;
    const ImageLight light(scene, b);
    const float* g = call.grad + b * all * 6;
    float* to = call.to_corners + call.tasks.image(task) * all * 9;
    double sum[LIGHT_SUMS] = {};
    NR_NO_VECTORS
    for (int f = call.tasks.begin(task), end = call.tasks.end(task, (int)all); f < end; ++f) {
        const Normal normal(scene, light, b, f);
        const float *n = normal.n, *p = normal.p, *q = normal.q, facing = normal.facing;
        const float *front = g + 3 * f, *back = g + 3 * (all + f);
        const float* lit = facing > 0.0f ? front : back;
        float gain = 0.0f;
        for (int k = 0; k < 3; ++k) {
            sum[k] += front[k] + back[k];
            sum[3 + k] += lit[k] * fabsf(facing);
            gain += lit[k] * light.beam[k];
        }
        // The sign of n . direction says which side is lit; none is if the light is parallel to the face.
        gain = facing > 0.0f ? gain : facing < 0.0f ? -gain : 0.0f;
        if (!scene.mirrored) gain = -gain;
        float to_n[3], to_v[9];
        for (int k = 0; k < 3; ++k) sum[6 + k] += gain * n[k], to_n[k] = gain * light.towards[k];
        const float along = normal.length > normal.floor ? gain * normal.toward : 0.0f;
        for (int k = 0; k < 3; ++k) to_n[k] = (to_n[k] - along * n[k]) * normal.part * normal.scale;
        for (int k = 0; k < 3; ++k) {
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            to_v[k] = q[l] * to_n[m] - q[m] * to_n[l];
            to_v[6 + k] = to_n[l] * p[m] - to_n[m] * p[l];
            to_v[3 + k] = -to_v[k] - to_v[6 + k];
        }
        if (call.to_vertices) {
            float* to_points = call.to_vertices + (light.points - scene.vertices);
            for (int k = 0; k < 3; ++k) {
                const int i = scene.triangles.vertex(b, f, k);
                for (int c = 0; i >= 0 && c < 3; ++c) atomic_add(to_points + 3 * (int64)i + c, to_v[3 * k + c]);
            }
        } else {
            for (int k = 0; k < 9; ++k) to[9 * (int64)f + k] = to_v[k] + (add ? to[9 * (int64)f + k] : 0.0f);
        }
    }
    float* whole = call.sums + ((int64)b * call.tasks.groups + call.tasks.group(task)) * LIGHT_SUMS;
    for (int k = 0; k < LIGHT_SUMS && call.sums; ++k) whole[k] = (float)sum[k];
}

NR_FUNC void light_faces_backward(const FlatLightBackward& call, int task) {
    const int image = call.tasks.image(task);
    if (call.targets == call.images) return light_group_backward(call, image, task, false);
    for (int b = 0; b < call.images; ++b) light_group_backward(call, b, task, b > 0);
}

}  // namespace nr
