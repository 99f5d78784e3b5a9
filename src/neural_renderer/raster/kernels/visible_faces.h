// Masks of visible faces.
#pragma once

#include "tasks.h"

namespace nr {

// Mark the faces that a row of pixels shows in the mask of their image, [count + 1], at the last pixel of each run that
// shows one face. Pixels without a face mark the last entry, because branches would be hard to predict.
NR_FUNC void mark_faces(int* mask, int count, const int* face_index, int64 pixels) {
    const auto mark = [&](int64 i) { store_relaxed(mask + (face_index[i] < 0 ? count : face_index[i]), 1); };
    for (int64 i = 0; i + 1 < pixels; i += 64)
        for (uint64 ends = changes_of_face(face_index + i, 1, (int)(pixels - 1 - i)); ends; ends &= ends - 1)
            mark(i + lowest_bit(ends));
    if (pixels > 0) mark(pixels - 1);
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
