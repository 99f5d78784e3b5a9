// Barycentric weights and depth of the visible point of each pixel, and their gradient.
#pragma once

#include "face.h"

namespace nr {

struct Weigh {
    Scene scene;
    float near, far;  // limits of depth; far is the depth of the background
    int each;         // rows of a task
    vec3* weights;    // [images, height, width], 0 where no face is visible
    float* depth;     // [images, height, width]
};

struct WeighRows {
    const Weigh& call;

    struct Nothing {};
    NR_FUNC void fresh(const Face&, const Place&, Nothing&) const {}
    NR_FUNC void empty(int count, const Place& place) const {
        for (int n = 0; n < count; ++n) call.depth[place.pixel + n] = call.far;
        memset(call.weights + place.pixel, 0, count * sizeof(vec3));
    }
    // Only rounding errors leave the range.
    template <class F>
    NR_FUNC F limited(F z) const {
        return select(z < call.near, all<F>(call.near), select(z > call.far, all<F>(call.far), z));
    }
    NR_FUNC void one(const Face&, const Point<float>& point, const Place& place, Nothing&) const {
        call.weights[place.pixel] = {point.weights[0], point.weights[1], point.weights[2]};
        call.depth[place.pixel] = limited(point.z);
    }
#if NR_LANES
    void run(const Face&, const Point<floats8>& points, int count, const Place& place, Nothing&) const {
        const floats8 *w = points.weights, z = limited(points.z);
        if (place.i + 8 <= call.scene.width) {
            store(call.weights + place.pixel, w[0], w[1], w[2]);
            store(call.depth + place.pixel, z);
        } else
            for (int n = 0; n < count; ++n) {
                call.weights[place.pixel + n] = {w[0][n], w[1][n], w[2][n]};
                call.depth[place.pixel + n] = z[n];
            }
    }
#endif
};

// The pixels of a task.
NR_FUNC void weigh_pixels(const Weigh& call, int task) {
    over_rows<WeighRows::Nothing>(call.scene, task, call.each, WeighRows{call});
}

struct BarycentricsBackward {
    Scene scene;
    const vec3* grad_weights;  // [images, height, width]; null for zeros
    const float* grad_depth;   // [images, height, width]; null for zeros
    const int* visible;        // mask of visible faces, [images, count + 1]; on the CPU
    int run;                   // pixels of a task on CUDA
    vec3* to_faces;            // [images, count, 3], 0 before
};

struct FaceBackward {
    const BarycentricsBackward& call;
    const Slopes slopes;
    CornerSums<float> sums = {};
#if NR_LANES
    CornerSums<floats8> sums_of_eights = {};

    void eight(const Face& face, const Point<floats8>& points, const Place& place, ints8 here) {
        floats8 to_weights[3] = {}, to_depth = {};
        if (call.grad_depth) to_depth = load<floats8>(call.grad_depth + place.pixel);
        if (call.grad_weights) load(call.grad_weights + place.pixel, to_weights);
        for (int k = 0; k < 3; ++k) to_weights[k] = select(here, to_weights[k], floats8{});
        sums_of_eights.add(face, slopes, points, to_weights, select(here, to_depth, floats8{}), here);
    }
    void finish_eights(const Face&) { sums.add(sums_of_eights); }
#endif
    NR_FUNC void one(const Face& face, const Point<float>& point, const Place& place) {
        const vec3 to_weights = call.grad_weights ? call.grad_weights[place.pixel] : vec3{};
        sums.add(face, slopes, point, to_weights.c, call.grad_depth ? call.grad_depth[place.pixel] : 0.0f, true);
    }
};

NR_FUNC void face_backward(const BarycentricsBackward& call, int image, int f, const Box& box, bool exclusive) {
    Face face;
    face.set(call.scene.corners(image, f), call.scene);
    FaceBackward visitor = {call, Slopes(face)};
    over_face(call.scene, face, image, f, box, true, visitor);
    visitor.sums.give(call.to_faces + ((int64)image * call.scene.count + f) * 3, exclusive);
}

// The pixels that show one face of one image.
NR_FUNC void weights_of_face_backward(const BarycentricsBackward& call, int task) {
    const int image = task / call.scene.count, f = task % call.scene.count;
    if (call.visible[(int64)image * (call.scene.count + 1) + f] == 0) return;
    const Box box = box_of_face(call.scene, image, f);
    if (box.left <= box.right) face_backward(call, image, f, box, true);
}

// A run of contiguous pixels, face by face, on CUDA.
NR_FUNC void weights_of_run_backward(const BarycentricsBackward& call, int task) {
    for_each_run(call.scene, task, call.run, [&](int image, int f, int j, int first, int last) {
        face_backward(call, image, f, Box{first, last, j, j}, false);
    });
}

struct WeighForward {
    Scene scene;
    Motion motion;
    vec3* weights;  // change, [directions, images, height, width]
    float* depth;   // change, [directions, images, height, width]
};

struct WeightChanges {
    const WeighForward& call;

    struct Nothing {};
    template <class F>
    NR_FUNC Nothing at(const Face&, const Point<F>&, const Place&) const {
        return {};
    }
    template <class F>
    NR_FUNC void store(const Nothing&, const PointChange<F>& moved, int t, int count, const Place& place) const {
        const int64 to = first(t, place);
        for (int n = 0; n < count; ++n)
            for (int k = 0; k < 3; ++k) call.weights[to + n][k] = lane(moved.weights[k], n);
        store_first(call.depth + to, moved.z, count);
    }
    NR_FUNC void clear(int t, int count, const Place& place) const {
        memset(call.weights + first(t, place), 0, count * sizeof(vec3));
        memset(call.depth + first(t, place), 0, count * sizeof(float));
    }
    NR_FUNC int64 first(int t, const Place& place) const {
        return t * call.scene.images * call.scene.area() + place.pixel;
    }
};

// The pixels of a task.
NR_FUNC void weights_of_pixels_forward(const WeighForward& call, int task) {
    over_changes(call.scene, call.motion, task, WeightChanges{call});
}

}  // namespace nr
