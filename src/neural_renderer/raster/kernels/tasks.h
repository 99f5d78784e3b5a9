// Tasks: which pixels or faces a task of a launch has. On the CPU a task is long, and no two write to one place; on
// CUDA it is a short thread of many thousands. See `raster/warp/layout.py`, which divides the work.
#pragma once

#include "geometry.h"
#include "lanes.h"

namespace nr {

// Pixels [left, right) of the rows [first, last), which count from the top over all images.
struct Pixels {
    int first, last, left, right;
};

// The pixels of a task of ``each`` rows, 0 for a single pixel, in maps of ``rows`` rows; see `pixel_tasks`.
NR_FUNC Pixels pixels_of_task(int task, int each, int rows, int width) {
    if (ON_CUDA && each == 0) return {task / width, task / width + 1, task % width, task % width + 1};
    // CPU tasks have whole rows alone: compilers make better loops of them.
    const int first = task * each;
    return {first, first + each < rows ? first + each : rows, 0, width};
}

// The gradient to images, [images, channels, height, width]; or, if ``halved``, one for each block of 2 x 2 pixels.
struct ImageGrad {
    const float* values;
    int halved, height, width;  // 0 or 1; size of the images

    // The gradient of a row from the top, of an image's channel.
    NR_FUNC const float* row(int64 plane, int j) const {
        return values + (plane * (height >> halved) + (j >> halved)) * (width >> halved);
    }
    NR_FUNC float at(const float* row, int i) const { return row[i >> halved]; }
#if NR_LANES
    // The gradient of eight pixels.
    floats8 eight(const float* row, int i) const {
        if (!halved) return load<floats8>(row + i);
        const floats4 own = load<floats4>(row + i / 2), next = load<floats4>(row + (i + 1) / 2);
        return __builtin_shufflevector(own, next, 0, 4, 1, 5, 2, 6, 3, 7);
    }
#endif
};

// Call visit(image, face, row, first, last) for each run of pixels [first, last] of one row that show one face, among
// the neighbours of a task of ``run`` pixels; see `run_tasks`. Rows count from the bottom of their image.
template <class Visit>
NR_FUNC void for_each_run(const Scene& scene, int task, int run, Visit visit) {
    const int runs = (scene.width + run - 1) / run, row = task / runs;
    const int begin = (task % runs) * run, end = smaller(begin + run, scene.width);
    const int* shown = scene.face_index + (int64)row * scene.width;
    for (int i = begin; i < end;) {
        int stop = i;
        while (stop < end && shown[stop] == shown[i]) ++stop;
        if (shown[i] >= 0) visit(row / scene.height, shown[i], scene.height - 1 - row % scene.height, i, stop - 1);
        i = stop;
    }
}

// Call visit(image, own, face, box) for the pixels of a face, a task, in each image where it is visible. Its values lie
// in image ``own`` of ``owners``. All images share those of a single owner, whose gradient one task sums, image by
// image.
template <class Visit>
NR_FUNC void for_each_view(const Scene& scene, const int* visible, int owners, int task, Visit visit) {
    const int own = task / scene.count, face = task % scene.count;
    const int first = owners == 1 ? 0 : own, last = owners == 1 ? scene.images : own + 1;
    for (int image = first; image < last; ++image) {
        if (visible[(int64)image * (scene.count + 1) + face] == 0) continue;
        const Box box = box_of_face(scene, image, face);
        if (box.left <= box.right) visit(image, own, face, box);
    }
}

}  // namespace nr
