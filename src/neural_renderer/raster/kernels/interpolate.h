// Attributes of corners, interpolated at each pixel, and the gradient.
#pragma once

#include "face.h"

namespace nr {

struct Interpolate {
    Scene scene;
    const float* attributes;  // values at the corners, [owners, count, 3, channels]
    int owners;               // images of attributes: 1 if all share them
    int channels;
    int each;       // rows of a task
    float* result;  // [images, height, width, channels], 0 where no face is visible
};

struct InterpolateRows {
    const Interpolate& call;

    struct Nothing {};
    NR_FUNC void fresh(const Face&, const Place&, Nothing&) const {}
    NR_FUNC void empty(int count, const Place& place) const {
        memset(to(place), 0, (int64)count * call.channels * sizeof(float));
    }
    NR_FUNC void one(const Face&, const Point<float>& point, const Place& place, Nothing&) const {
        for (int c = 0; c < call.channels; ++c)
            to(place)[c] = interpolated(point.weights, from(place), c, call.channels);
    }
#if NR_LANES
    // Three channels, the usual case, are stored together.
    void run(const Face&, const Point<floats8>& points, int count, const Place& place, Nothing&) const {
        const float* corners = from(place);
        const int channels = call.channels;
        const auto mixed = [&](int c, int n) { return interpolated(points.weights, corners, c, n); };
        if (channels == 3 && place.i + 8 <= call.scene.width)
            return store((vec3*)to(place), mixed(0, 3), mixed(1, 3), mixed(2, 3));
        for (int c = 0; c < channels; ++c) {
            float values[8];
            store(values, mixed(c, channels));
            for (int n = 0; n < count; ++n) to(place)[n * channels + c] = values[n];
        }
    }
#endif
    NR_FUNC const float* from(const Place& place) const {
        const int owner = broadcast(place.image, call.owners);
        return call.attributes + ((int64)owner * call.scene.count + place.face) * 3 * call.channels;
    }
    NR_FUNC float* to(const Place& place) const { return call.result + place.pixel * call.channels; }
};

// The pixels of a task.
NR_FUNC void interpolate_pixels(const Interpolate& call, int task) {
    over_rows<InterpolateRows::Nothing>(call.scene, task, call.each, InterpolateRows{call});
}

struct InterpolateBackward {
    Scene scene;
    const float* attributes;  // values at the corners, [owners, count, 3, channels]
    int owners;               // images of attributes: 1 if all share them
    int channels;
    const float* grad;     // [images, height, width, channels]
    int faces_too;         // whether the gradient to faces is needed
    const int* visible;    // mask of visible faces, [images, count + 1]; on the CPU
    int run;               // pixels of a task on CUDA
    float* to_attributes;  // [owners, count, 3, channels], 0 before
    vec3* to_faces;        // [images, count, 3], 0 before
};

// Sums over the pixels of one face.
struct CornersBackward {
    const InterpolateBackward& call;
    const int channels;
    const float* from;  // attributes at the corners
    float* to;          // their gradient
    const bool exclusive;
    const Slopes slopes;
    CornerSums<float> sums = {};

#if NR_LANES
    // Equivalent to `CornerSums::add`, but sums first: the gradients of weights are products of ``from`` and the
    // cotangent, so sums of weights[k] * cotangent suffice for the corners, and in perspective sums of weights[k] *
    // color * cotangent.
    static constexpr int MOST = 8;  // channels
    floats8 sums_of_cotangent[3 * MOST] = {}, sums_of_color[3] = {};
    float relative[3 * MOST] = {};  // attributes minus those of the first corner; a common offset has no gradient
    const bool colors_too = call.faces_too && call.scene.perspective;

    void prepare() {
        for (int k = 0; k < 3; ++k)
            for (int c = 0; c < channels; ++c) relative[k * channels + c] = from[k * channels + c] - from[c];
    }
    void eight(const Face&, const Point<floats8>& points, const Place& place, ints8 here) {
        const floats8* w = points.weights;
        const float* g = call.grad + place.pixel * channels;
        __builtin_prefetch(g - ROWS_AHEAD * call.scene.width * channels);
        floats8 cotangents[MOST], color{};
        if (channels == 3) load((const vec3*)g, cotangents);
        else
            for (int c = 0; c < channels; ++c, ++g)
                for (int n = 0; n < 8; ++n) cotangents[c][n] = g[n * channels];
        const auto add = [&](int c, int channels) {
            const floats8 cotangent = select(here, cotangents[c], floats8{});
            for (int k = 0; k < 3; ++k) sums_of_cotangent[3 * c + k] += w[k] * cotangent;
            if (colors_too) color += cotangent * (w[1] * relative[channels + c] + w[2] * relative[2 * channels + c]);
        };
        if (channels == 3) add(0, 3), add(1, 3), add(2, 3);
        else
            for (int c = 0; c < channels; ++c) add(c, channels);
        if (colors_too)
            for (int k = 0; k < 3; ++k) sums_of_color[k] += w[k] * color;
    }
    void finish_eights(const Face& face) {
        float total[3 * MOST];
        for (int c = 0; c < channels; ++c)
            for (int k = 0; k < 3; ++k)
                to[k * channels + c] += total[k * channels + c] = sum(sums_of_cotangent[3 * c + k]);
        if (call.faces_too) sums.add_attributes<MOST>(face, slopes, relative, total, sums_of_color, channels);
    }
#endif
    NR_FUNC void one(const Face& face, const Point<float>& point, const Place& place) {
        const float* cotangent = call.grad + place.pixel * channels;
        vec3 to_weights = {};
        for (int k = 0; k < 3; ++k)
            for (int c = 0; c < channels; ++c) {
                to_weights[k] += from[k * channels + c] * cotangent[c];
                add(to + k * channels + c, point.weights[k] * cotangent[c], exclusive);
            }
        if (call.faces_too) sums.add(face, slopes, point, to_weights.c, 0.0f, true);
    }
};

// The pixels of a box that show face f, with the attributes of image ``owner``. If ``exclusive``, no other task writes
// there.
NR_FUNC void corners_backward(
    const InterpolateBackward& call, int image, int owner, int f, const Box& box, bool exclusive) {
    const int64 at = ((int64)owner * call.scene.count + f) * 3 * call.channels;
    Face face;
    face.set(call.scene.corners(image, f), call.scene);
    CornersBackward visitor = {call,      call.channels, call.attributes + at, call.to_attributes + at,
                               exclusive, Slopes(face)};
    const bool few = call.channels <= 8;
#if NR_LANES
    if (few) visitor.prepare();
#endif
    over_face(call.scene, face, image, f, box, few, visitor);
    if (call.faces_too) visitor.sums.give(call.to_faces + ((int64)image * call.scene.count + f) * 3, exclusive);
}

// The pixels that show one face, in one image or, if images share attributes, in all.
NR_FUNC void attributes_of_face_backward(const InterpolateBackward& call, int task) {
    for_each_view(call.scene, call.visible, call.owners, task, [&](int image, int owner, int f, const Box& box) {
        corners_backward(call, image, owner, f, box, true);
    });
}

// A run of contiguous pixels, face by face, on CUDA.
NR_FUNC void attributes_of_run_backward(const InterpolateBackward& call, int task) {
    for_each_run(call.scene, task, call.run, [&](int image, int f, int j, int first, int last) {
        corners_backward(call, image, broadcast(image, call.owners), f, Box{first, last, j, j}, false);
    });
}

struct InterpolateForward {
    Interpolate forward;  // arguments of `Interpolate`; each and result are not used
    Motion motion;
    float* change;  // [directions, images, height, width, channels]
};

struct AttributeChanges {
    const InterpolateForward& call;

    template <class F>
    NR_FUNC const float* at(const Face&, const Point<F>&, const Place& place) const {
        return InterpolateRows{call.forward}.from(place);
    }
    template <class F>
    NR_FUNC void store(const float* from, const PointChange<F>& moved, int t, int count, const Place& place) const {
        const int channels = call.forward.channels;
        float* to = first(t, place);
        for (int c = 0; c < channels; ++c) {
            const F change = interpolated(moved.weights, from, c, channels);
            for (int n = 0; n < count; ++n) to[n * channels + c] = lane(change, n);
        }
    }
    NR_FUNC void clear(int t, int count, const Place& place) const {
        memset(first(t, place), 0, (int64)count * call.forward.channels * sizeof(float));
    }
    NR_FUNC float* first(int t, const Place& place) const {
        const int64 pixel = t * call.forward.scene.images * call.forward.scene.area() + place.pixel;
        return call.change + pixel * call.forward.channels;
    }
};

// The pixels of a task.
NR_FUNC void interpolate_pixels_forward(const InterpolateForward& call, int task) {
    over_changes(call.forward.scene, call.motion, task, AttributeChanges{call});
}

}  // namespace nr
