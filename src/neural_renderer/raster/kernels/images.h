// Images in memory: backgrounds with any strides, and gradients of images or of their blocks of pixels.
#pragma once

#include "lanes.h"

namespace nr {

// A background with the strides that users pass: one colour, one image, or a batch.
struct Background {
    const float* values;                // the first pixel of the first channel of the first image
    int64 image, channel, row, column;  // strides; 0 for a broadcast dimension

    // The first pixel of row j from the top.
    NR_FUNC const float* at(int b, int c, int j) const { return values + b * image + c * channel + j * row; }
    // Copy ``count`` pixels of such a row, starting at pixel i.
    NR_FUNC void copy(int b, int c, int j, int i, int count, float* to) const {
        const float* from = at(b, c, j) + i * column;
        if (column == 0)
            for (int n = 0; n < count; ++n) to[n] = *from;
        else
            for (int n = 0; n < count; ++n) to[n] = from[n * column];
    }
};

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
        const floats4 first = load<floats4>(row + i / 2), next = load<floats4>(row + (i + 1) / 2);
        return __builtin_shufflevector(first, next, 0, 4, 1, 5, 2, 6, 3, 7);
    }
    void prefetch(int64 plane, int j, int i) const { __builtin_prefetch(row(plane, j) + (i >> halved)); }
#endif
};

}  // namespace nr
