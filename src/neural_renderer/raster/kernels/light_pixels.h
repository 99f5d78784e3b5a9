// Lit colours over a background: the colour of each pixel times the light on the visible side of its face, and the
// gradient.
#pragma once

#include "images.h"
#include "tasks.h"

namespace nr {

struct LightPixels {
    Scene scene;
    const vec3* colors;     // [images, height, width]
    Background background;  // shows where no face is visible
    const vec3* light;      // factors on the front and the back of each face, [lamps, 2, faces]
    int lamps;              // images of light; 1 if all share it
    int each;               // rows of a task
    float* image;           // result, [images, 3, height, width]
};

// Neighbouring pixels [left, right) of a row that show one face, or the background.
struct LitRun {
    int image, face;  // face is -1 for the background
    int side;         // the visible side of the face: 0 the front, 1 the back
    vec3 factor;      // the light on it
    int left, right;
};

// Call visit(run) for the runs among the pixels [left, right) of a row, which counts over all images.
template <class Visit>
NR_FUNC void for_each_lit_run(const LightPixels& call, int row, int left, int right, Visit visit) {
    const Scene& scene = call.scene;
    const int b = row / scene.height, lamp = broadcast(b, call.lamps);
    const int* shown = scene.face_index + (int64)row * scene.width;
    for (int i = left; i < right;) {
        LitRun run = {b, shown[i], 0, {}, i, 0};
        for (++i; i < right && shown[i] == run.face;) ++i;
        run.right = i;
        if (run.face >= 0) {
            run.side = visible_side(scene.corners(b, run.face), scene.perspective);
            run.factor = call.light[(2 * (int64)lamp + run.side) * scene.count + run.face];
        }
        visit(run);
    }
}

// The pixels of a task.
NR_FUNC void light_pixels(const LightPixels& call, int task) {
    const Scene& scene = call.scene;
    const Pixels pixels = pixels_of_task(task, call.each, scene.images * scene.height, scene.width);
    for (int row = pixels.first; row < pixels.last; ++row) {
        const int j = row % scene.height;
        const vec3* __restrict__ colors = call.colors + (int64)row * scene.width;
        for_each_lit_run(call, row, pixels.left, pixels.right, [&](const LitRun& run) {
            float* __restrict__ to = call.image + (3 * (int64)run.image * scene.height + j) * scene.width;
            const int64 area = scene.area();
            int i = run.left;
            if (run.face < 0) {
                for (int c = 0; c < 3; ++c) call.background.copy(run.image, c, j, i, run.right - i, to + c * area + i);
                return;
            }
#if NR_LANES
            for (floats8 color[3]; i < run.right && i + 8 <= scene.width; i += 8) {  // later runs overwrite the rest
                load(colors + i, color);
                for (int c = 0; c < 3; ++c) store(to + c * area + i, color[c] * run.factor[c]);
            }
#endif
            for (; i < run.right; ++i)
                for (int c = 0; c < 3; ++c) to[c * area + i] = colors[i][c] * run.factor[c];
        });
    }
}

struct LightPixelsBackward {
    LightPixels forward;  // arguments of `LightPixels`; background, each and image are not used
    ImageGrad grad;       // gradient to the image
    int run;              // contiguous pixels of a task; 0 for a whole image, whose light no other task writes
    vec3* to_colors;      // [images, height, width]
    vec3* to_light;       // [images, 2, faces], 0 before
};

// The pixels of a task.
NR_FUNC void light_pixels_backward(const LightPixelsBackward& call, int task) {
    const Scene& scene = call.forward.scene;
    const int tasks = call.run ? (scene.width + call.run - 1) / call.run : 1;  // tasks of a row
    const int first = call.run ? task / tasks : task * scene.height, last = call.run ? first + 1 : first + scene.height;
    const int left = task % tasks * call.run, right = call.run ? min(left + call.run, scene.width) : scene.width;
    for (int row = first; row < last; ++row)
        for_each_lit_run(call.forward, row, left, right, [&](const LitRun& run) {
            const int64 start = (int64)row * scene.width;
            const vec3* __restrict__ colors = call.forward.colors + start;
            vec3* __restrict__ to = call.to_colors + start;
            if (run.face < 0) {
                memset(to + run.left, 0, (run.right - run.left) * sizeof(vec3));
                return;
            }
            const float* from[3];
            for (int c = 0; c < 3; ++c) from[c] = call.grad.row(3 * (int64)run.image + c, row % scene.height);
            vec3 sums = {};
            int i = run.left;
#if NR_LANES
            floats8 color[3], grad[3], lit[3] = {};
            for (; i < run.right && i + 8 <= scene.width; i += 8) {  // later runs overwrite the rest
                const ints8 here = lane_numbers<ints8>() < run.right - i;
                load(colors + i, color);
                for (int c = 0; c < 3; ++c) {
                    grad[c] = call.grad.eight(from[c], i);
                    lit[c] += select(here, grad[c] * color[c], floats8{});
                }
                store(to + i, grad[0] * run.factor[0], grad[1] * run.factor[1], grad[2] * run.factor[2]);
            }
            for (int c = 0; c < 3; ++c) sums[c] = sum(lit[c]);
#endif
            for (; i < run.right; ++i)
                for (int c = 0; c < 3; ++c) {
                    const float grad = call.grad.at(from[c], i);
                    to[i][c] = grad * run.factor[c], sums[c] += grad * colors[i][c];
                }
            add(call.to_light + (2 * (int64)run.image + run.side) * scene.count + run.face, sums, call.run == 0);
        });
}

// Tangents of lit colours in several directions.
struct LightPixelsForward {
    LightPixels forward;    // arguments of `LightPixels`; background and image are not used
    const vec3* to_colors;  // changes of the colours, [directions, images, height, width]; or null
    const vec3* to_light;   // changes of the light, [directions, lamps, 2, faces]; or null
    int directions;
    float* change;  // [directions, images, 3, height, width]
};

// The pixels of a run in one direction.
NR_FUNC void change_run(const LightPixelsForward& call, const LitRun& run, int row, int t) {
    const LightPixels& lit = call.forward;
    const Scene& scene = lit.scene;
    const int64 area = scene.area(), image = (int64)t * scene.images + run.image;
    float* __restrict__ to = call.change + (3 * image * scene.height + row % scene.height) * scene.width;
    if (run.face < 0) {
        for (int c = 0; c < 3; ++c) memset(to + c * area + run.left, 0, (run.right - run.left) * sizeof(float));
        return;
    }
    const int64 lamp = (int64)t * lit.lamps + broadcast(run.image, lit.lamps);
    const vec3 by = call.to_light ? call.to_light[(2 * lamp + run.side) * scene.count + run.face] : vec3{};
    const vec3* __restrict__ colors = lit.colors + (int64)row * scene.width;
    const vec3* moved = call.to_colors ? call.to_colors + t * scene.images * area + (int64)row * scene.width : nullptr;
    int i = run.left;
#if NR_LANES
    for (floats8 color[3], change[3] = {}; i < run.right && i + 8 <= scene.width; i += 8) {  // as in `light_pixels`
        load(colors + i, color);
        if (moved) load(moved + i, change);
        for (int c = 0; c < 3; ++c) store(to + c * area + i, change[c] * run.factor[c] + color[c] * by[c]);
    }
#endif
    for (; i < run.right; ++i)
        for (int c = 0; c < 3; ++c)
            to[c * area + i] = (moved ? moved[i][c] * run.factor[c] : 0.0f) + colors[i][c] * by[c];
}

// The pixels of a task.
NR_FUNC void light_pixels_forward(const LightPixelsForward& call, int task) {
    const Scene& scene = call.forward.scene;
    const Pixels pixels = pixels_of_task(task, call.forward.each, scene.images * scene.height, scene.width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for_each_lit_run(call.forward, row, pixels.left, pixels.right, [&](const LitRun& run) {
            for (int t = 0; t < call.directions; ++t) change_run(call, run, row, t);
        });
}

}  // namespace nr
