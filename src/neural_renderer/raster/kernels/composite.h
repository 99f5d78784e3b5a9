// The colours of visible faces over a background, and the gradient to the colours.
#pragma once

#include "images.h"
#include "tasks.h"

namespace nr {

struct Composite {
    const float* colors;  // [images, height, width, channels]
    Background background;
    const int* face_index;  // [images / repeats, height, width]; the background shows where it is -1
    int images, channels, height, width;
    int repeats;   // how many times the images of faces are repeated, one batch after the other
    int each;      // rows of a task
    float* image;  // result, [images, channels, height, width]
};

// Three channels, the usual case, are processed eight pixels at a time on the CPU.
NR_FUNC void composite_row(const Composite& call, int row, int left, int right) {
    const int channels = call.channels, b = row / call.height, j = row % call.height;
    const int64 area = (int64)call.height * call.width, start = (int64)row * call.width;
    const int* __restrict__ shown = call.face_index + start % (call.images / call.repeats * area);
    const float* __restrict__ color = call.colors + start * channels;
    float* __restrict__ to = call.image + b * channels * area + (int64)j * call.width;
    const Background& behind = call.background;
#if NR_LANES
    if (channels == 3 && (behind.column == 0 || behind.column == 1))
        for (; left + 8 <= right; left += 8) {
            const ints8 here = load<ints8>(shown + left);
            floats8 front[3];
            load((const vec3*)(color + 3 * left), front);
            for (int c = 0; c < 3; ++c) {
                const float* from = behind.at(b, c, j);
                const floats8 back = behind.column == 0 ? all<floats8>(*from) : load<floats8>(from + left);
                store(to + c * area + left, select(here < 0, back, front[c]));
            }
        }
#endif
    for (int c = 0; c < channels; ++c, to += area) {
        const float* from = behind.at(b, c, j);
        for (int i = left; i < right; ++i)
            to[i] = shown[i] < 0 ? from[i * behind.column] : color[(int64)i * channels + c];
    }
}

// The pixels of a task.
NR_FUNC void composite_pixels(const Composite& call, int task) {
    const Pixels pixels = pixels_of_task(task, call.each, call.images * call.height, call.width);
    for (int row = pixels.first; row < pixels.last; ++row) composite_row(call, row, pixels.left, pixels.right);
}

struct CompositeBackward {
    ImageGrad grad;         // gradient to the image
    const int* face_index;  // [images, height, width]
    int images, channels, height, width;
    int each;          // rows of a task
    float* to_colors;  // [images, height, width, channels]
};

// The transpose of `composite_row` for the colours.
NR_FUNC void composite_row_backward(const CompositeBackward& call, int row, int left, int right) {
    const int channels = call.channels, b = row / call.height, j = row % call.height;
    const int64 start = (int64)row * call.width, plane = (int64)b * channels;
    const int* __restrict__ shown = call.face_index + start;
    float* __restrict__ to = call.to_colors + start * channels;
#if NR_LANES
    if (channels == 3)
        for (; left + 8 <= right; left += 8) {
            const ints8 here = load<ints8>(shown + left);
            floats8 result[3];
            for (int c = 0; c < 3; ++c)
                result[c] = select(here < 0, floats8{}, call.grad.eight(call.grad.row(plane + c, j), left));
            store((vec3*)(to + 3 * left), result[0], result[1], result[2]);
        }
#endif
    for (int c = 0; c < channels; ++c) {
        const float* __restrict__ from = call.grad.row(plane + c, j);
        for (int i = left; i < right; ++i) to[(int64)i * channels + c] = shown[i] < 0 ? 0.0f : call.grad.at(from, i);
    }
}

// The pixels of a task.
NR_FUNC void composite_pixels_backward(const CompositeBackward& call, int task) {
    const Pixels pixels = pixels_of_task(task, call.each, call.images * call.height, call.width);
    for (int row = pixels.first; row < pixels.last; ++row) composite_row_backward(call, row, pixels.left, pixels.right);
}

}  // namespace nr
