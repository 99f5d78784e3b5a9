// A background in memory as users pass it: one colour, an image, or many.
#pragma once

#include "platform.h"

namespace nr {

struct Background {
    const float* values;                // the first pixel of the first channel of the first image
    int64 image, channel, row, column;  // strides; 0 where all share the values

    // The first pixel of row j from the top.
    NR_FUNC const float* at(int b, int c, int j) const { return values + b * image + c * channel + j * row; }
    // Copy ``count`` pixels of such a row from pixel i on.
    NR_FUNC void copy(int b, int c, int j, int i, int count, float* to) const {
        const float* from = at(b, c, j) + i * column;
        if (column == 0)
            for (int n = 0; n < count; ++n) to[n] = *from;
        else
            for (int n = 0; n < count; ++n) to[n] = from[n * column];
    }
};

}  // namespace nr
