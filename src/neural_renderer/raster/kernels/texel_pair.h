// The two texels along one side of an image around a coordinate.
#pragma once

#include "platform.h"

namespace nr {

// The places of the names in `texture_levels.py`. Texels beyond the image are those of its other end, the border's own,
// zero, or on another face of the cube.
constexpr int WRAP = 0, CLAMP = 1, ZERO = 2, CUBE = 3;

struct TexelPair {
    int texel[2];   // on the image for WRAP and CLAMP; else one step beyond it at most
    float part[2];  // their shares
    float slope;    // slope of the position by the coordinate, in texels

    NR_FUNC TexelPair(float at, int size, int boundary, bool nearest = false) {
        const float last = (float)(size - 1), beyond = boundary == CLAMP ? 0.0f : boundary == CUBE ? 0.5f : 1.0f;
        const float raw = (boundary == WRAP ? at - floorf(at) : at) * (float)size - 0.5f;
        const float x = clamp(raw, -beyond, last + beyond);  // a number for NaN coordinates, too
        slope = x == raw ? (float)size : 0.0f;
        const float low = floorf(nearest ? x + 0.5f : x);
        part[1] = nearest ? 0.0f : x - low, part[0] = 1.0f - part[1];
        int first = (int)low;
        if (nearest && boundary != ZERO) first = larger(0, smaller(first, size - 1));
        for (int k = 0; k < 2; ++k) {
            int n = first + k;
            if (boundary == WRAP) n = n < 0 ? n + size : n >= size ? n - size : n;
            if (boundary == CLAMP) n = n >= size ? size - 1 : n;
            texel[k] = n;
        }
    }
};

}  // namespace nr
