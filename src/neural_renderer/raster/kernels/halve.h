// Downsampling of anti-aliased images: the mean of 2 x 2 pixels.
#pragma once

#include "tasks.h"

namespace nr {

struct Halve {
    float* image;     // [2 rows, 2 width]
    float* means;     // [rows, width]
    int rows, width;  // size of the means; rows of all images and channels
    int each;         // rows of a task
};

// Call visit(mean, above, below) for each block of a task: its mean, and its pixel pairs in the upper and lower row.
template <class Visit>
NR_FUNC void for_each_block(const Halve& call, int task, Visit visit) {
    const int width = call.width;
    const Pixels pixels = pixels_of_task(task, call.each, call.rows, width);
    for (int row = pixels.first; row < pixels.last; ++row) {
        float* __restrict__ means = call.means + (int64)row * width;
        float* __restrict__ above = call.image + (int64)row * 4 * width;
        float* __restrict__ below = above + 2 * width;
        for (int i = pixels.left; i < pixels.right; ++i) visit(means[i], above + 2 * i, below + 2 * i);
    }
}

// Adds quarters, because the sum of four values may overflow.
NR_FUNC void average_blocks(const Halve& call, int task) {
    for_each_block(call, task, [](float& mean, const float* above, const float* below) {
        mean = (0.25f * above[0] + 0.25f * below[0]) + (0.25f * above[1] + 0.25f * below[1]);
    });
}

// The transpose: each pixel of a block gets a quarter of the gradient to its mean.
NR_FUNC void average_blocks_backward(const Halve& call, int task) {
    for_each_block(call, task, [](const float& mean, float* above, float* below) {
        above[0] = above[1] = below[0] = below[1] = 0.25f * mean;
    });
}

}  // namespace nr
