// The visible face of each pixel, and the silhouette.
#pragma once

#include "draw.h"
#include "halve.h"

namespace nr {

struct Silhouette {
    const int* face_index;  // [images, height, width], -1 where no face is visible
    int width;              // pixels of the result
    int rows;               // rows of the result, of all images
    int halved;             // whether a pixel of the result is the mean of 2 x 2 pixels
    int each;               // rows of a task
    float* alpha;           // result, [rows, width]
};

// The pixels of a task: 1 where a face is visible, else 0.
NR_FUNC void cover_pixels(const Silhouette& call, int task) {
    const Pixels pixels = pixels_of_task(task, call.each, call.rows, call.width);
    for (int row = pixels.first; row < pixels.last; ++row) {
        float* __restrict__ to = call.alpha + (int64)row * call.width;
        const int* __restrict__ shown = call.face_index + (int64)row * call.width * (call.halved ? 4 : 1);
        const int* __restrict__ below = shown + 2 * call.width;
        if (!call.halved) {
            for (int i = pixels.left; i < pixels.right; ++i) to[i] = shown[i] >= 0 ? 1.0f : 0.0f;
            continue;
        }
        for (int i = pixels.left; i < pixels.right; ++i) {
            const int first_two = (shown[2 * i] >= 0) + (shown[2 * i + 1] >= 0);
            to[i] = 0.25f * (float)(first_two + (below[2 * i] >= 0) + (below[2 * i + 1] >= 0));
        }
    }
}

}  // namespace nr
