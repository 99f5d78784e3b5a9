// Masks of visible faces.
#pragma once

#include "tasks.h"

namespace nr {

// Mark the faces that a row of pixels shows in the mask of their image, [count + 1]. Pixels without a face mark the
// last entry instead of branching: neighbouring pixels differ too often for branch prediction.
NR_FUNC void mark_faces(int* mask, int count, const int* face_index, int64 pixels) {
    for (int64 i = 0; i < pixels; ++i) store_relaxed(mask + (face_index[i] < 0 ? count : face_index[i]), 1);
}

struct Mark {
    Scene scene;   // scene without corners
    int each;      // rows of a task
    int* visible;  // mask, [images, count + 1], 0 before
};

// The pixels of a task.
NR_FUNC void mark_pixels(const Mark& call, int task) {
    const Scene& scene = call.scene;
    const Pixels pixels = pixels_of_task(task, call.each, scene.images * scene.height, scene.width);
    for (int row = pixels.first; row < pixels.last; ++row) {
        int* mask = call.visible + (int64)(row / scene.height) * (scene.count + 1);
        const int* shown = scene.face_index + (int64)row * scene.width + pixels.left;
        mark_faces(mask, scene.count, shown, pixels.right - pixels.left);
    }
}

}  // namespace nr
