// Tasks: the pixels or faces that one task of a launch processes. On the CPU a task is long, and no two tasks write to
// the same address; on CUDA it is one of many thousands of short threads. `raster/warp/layout.py` divides the work.
#pragma once

#include "geometry.h"
#include "lanes.h"

namespace nr {

// Loops over the rows of a face, from the bottom, prefetch the pixels some rows up: processors foresee no such steps,
// and caches are slower than the arithmetic.
constexpr int ROWS_AHEAD = 3;

// Pixels [left, right) of the rows [first, last), which count from the top over all images.
struct Pixels {
    int first, last, left, right;
};

// The pixels of a task of ``each`` rows, 0 for a single pixel, in maps of ``rows`` rows; see `pixel_tasks`.
NR_FUNC Pixels pixels_of_task(int task, int each, int rows, int width) {
    if (ON_CUDA && each == 0) return {task / width, task / width + 1, task % width, task % width + 1};
    // CPU tasks have whole rows only, for which compilers generate better loops.
    const int first = task * each;
    return {first, first + each < rows ? first + each : rows, 0, width};
}

// Runs of pixels that one task processes together where all show the same face, so that it adds one sum in place of
// many, for which the threads of a large face would wait.
constexpr int RUNS_OF_ONE_FACE = 4;

// Whether all ``count`` pixels show the same face.
NR_FUNC bool show_one_face(const int* shown, int count) {
    if (shown[0] != shown[count - 1]) return false;  // most of a fine mesh
    for (int i = 1; i < count - 1; ++i)
        if (shown[i] != shown[0]) return false;
    return true;
}

// Bit n of the result: pixel n from ``shown`` on, of at most 64, and the one ``step`` further show different faces.
NR_FUNC uint64 changes_of_face(const int* shown, int step, int count) {
    uint64 changes = 0;
    int n = 0;
    count = min(count, 64);
#if NR_LANES
    for (; n + 8 <= count; n += 8)
        changes |= (uint64)bits(load<ints8>(shown + n) != load<ints8>(shown + n + step)) << n;
#endif
    for (; n < count; ++n) changes |= (uint64)(shown[n] != shown[n + step]) << n;
    return changes;
}

// Call visit(image, face, row, first, last) for each run of pixels [first, last] of a row that show the same face,
// among the ``run`` contiguous pixels of a task; see `run_tasks`. Rows count from the bottom of their image.
template <class Visit>
NR_FUNC void for_each_run(const Scene& scene, int task, int run, Visit visit) {
    const int runs = (scene.width + run - 1) / run, row = task / runs;
    const int* shown = scene.face_index + (int64)row * scene.width;
    int begin = (task % runs) * run, end = min(begin + run, scene.width);
    const int wide = RUNS_OF_ONE_FACE * run, first = begin / wide * wide;
    if (first + wide <= scene.width && show_one_face(shown + first, wide)) {
        if (begin > first) return;  // the task of the first run has them all
        end = first + wide;
    }
    for (int i = begin; i < end;) {
        int stop = i;
        while (stop < end && shown[stop] == shown[i]) ++stop;
        if (shown[i] >= 0) visit(row / scene.height, shown[i], scene.height - 1 - row % scene.height, i, stop - 1);
        i = stop;
    }
}

// Call visit(image, owner, face, box) for each image where the face of a task is visible, with its bounding box. The
// face's values are those of image ``owner``. With one owner, all images share its values, and one task sums their
// gradient.
template <class Visit>
NR_FUNC void for_each_view(const Scene& scene, const int* visible, int owners, int task, Visit visit) {
    const int owner = task / scene.count, face = task % scene.count;
    const int first = owners == 1 ? 0 : owner, last = owners == 1 ? scene.images : owner + 1;
    for (int image = first; image < last; ++image) {
        if (visible[(int64)image * (scene.count + 1) + face] == 0) continue;
        const Box box = box_of_face(scene, image, face);
        if (box.left <= box.right) visit(image, owner, face, box);
    }
}

}  // namespace nr
