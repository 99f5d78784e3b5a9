// Masks of visible faces.
#pragma once

#include "tasks.h"

namespace nr {

// Mark the faces that ``pixels`` pixels show in the mask of their image, [count + 1]. The last entry stands for pixels
// without a face: there is no test, because faces of neighbouring pixels differ too often for a predictable branch.
NR_FUNC void mark_faces(int* mask, int count, const int* face_index, int64 pixels) {
    for (int64 i = 0; i < pixels; ++i) write_shared(mask + (face_index[i] < 0 ? count : face_index[i]), 1);
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
