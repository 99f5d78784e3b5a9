// Light on an image: the colour of each pixel times the light on the visible side of its face, and the gradient.
#pragma once

#include "tasks.h"

namespace nr {

struct LightPixels {
    Scene scene;
    const float* image;  // [images, 3, height, width]
    const vec3* light;   // factors on the front and the back of each face, [lamps, 2, faces]
    int lamps;           // images of light; 1 if all share it
    int each;            // rows of a task
    float* lit;          // result, [images, 3, height, width]
};

// Neighbouring pixels [begin, end) of a row that show one face, or the background.
struct LitRun {
    int image, face;   // face is -1 for the background
    int side;          // the visible side of the face: 0 the front, 1 the back
    vec3 factor;       // the light on it; 1 for the background
    int64 begin, end;  // places in the first channel of a map [images, 3, height, width]
};

// Call visit(run) for the runs among the pixels [left, right) of a row, which counts over all images.
template <class Visit>
NR_FUNC void for_each_lit_run(const LightPixels& call, int row, int left, int right, Visit visit) {
    const Scene& scene = call.scene;
    const int b = row / scene.height, lamp = shared(b, call.lamps);
    const int64 start = 2 * b * scene.area() + (int64)row * scene.width;
    const int* shown = scene.face_index + (int64)row * scene.width;
    for (int i = left; i < right;) {
        LitRun run = {b, shown[i], 0, {1.0f, 1.0f, 1.0f}, start + i, 0};
        for (++i; i < right && shown[i] == run.face;) ++i;
        run.end = start + i;
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
    for (int row = pixels.first; row < pixels.last; ++row)
        for_each_lit_run(call, row, pixels.left, pixels.right, [&](const LitRun& run) {
            for (int c = 0; c < 3; ++c)
                for (int64 n = run.begin + c * scene.area(); n < run.end + c * scene.area(); ++n)
                    call.lit[n] = call.image[n] * run.factor[c];
        });
}

struct LightPixelsBackward {
    LightPixels forward;  // arguments of `LightPixels`; each and lit are not used
    const float* grad;    // [images, 3, height, width]
    int run;              // neighbouring pixels of a task; 0 for a whole image, in whose light no other task writes
    float* to_image;      // [images, 3, height, width]
    vec3* to_light;       // [images, 2, faces], 0 before
};

// The pixels of a task.
NR_FUNC void light_pixels_backward(const LightPixelsBackward& call, int task) {
    const Scene& scene = call.forward.scene;
    const int tasks = call.run ? (scene.width + call.run - 1) / call.run : 1;  // tasks of a row
    const int first = call.run ? task / tasks : task * scene.height, last = call.run ? first + 1 : first + scene.height;
    const int left = task % tasks * call.run, right = call.run ? smaller(left + call.run, scene.width) : scene.width;
    for (int row = first; row < last; ++row)
        for_each_lit_run(call.forward, row, left, right, [&](const LitRun& run) {
            vec3 sum = {};
            for (int c = 0; c < 3; ++c)
                for (int64 n = run.begin + c * scene.area(); n < run.end + c * scene.area(); ++n) {
                    call.to_image[n] = call.grad[n] * run.factor[c];
                    sum[c] += call.grad[n] * call.forward.image[n];
                }
            const int64 to = (2 * (int64)run.image + run.side) * scene.count + run.face;
            if (run.face >= 0) add(call.to_light + to, sum, call.run == 0);
        });
}

}  // namespace nr
