// The two texels along one side of an image around a coordinate.
#pragma once

#include "lanes.h"

namespace nr {

// Boundary modes. Texels outside the image are those of its opposite side, those of its border, zero, or those of
// another face of the cube.
constexpr int WRAP = 0, CLAMP = 1, ZERO = 2, CUBE = 3;

// The pairs around the coordinates of one or several samples.
template <class F>
struct TexelPair {
    typename Lanes<F>::Ints texel[2];  // on the image for WRAP and CLAMP; else one step beyond it at most
    F part[2];                         // their weights
    F slope;                           // derivative of the position in texels by the coordinate

    NR_FUNC TexelPair(F at, typename Lanes<F>::Ints size, int boundary, bool nearest = false) {
        typedef typename Lanes<F>::Ints Ints;
        const F sides = to_floats(size), last = sides - 1.0f;
        const float beyond = boundary == CLAMP ? 0.0f : boundary == CUBE ? 0.5f : 1.0f;
        const F raw = (boundary == WRAP ? at - floor_of(at) : at) * sides - 0.5f;
        const F low_end = all<F>(-beyond), high_end = last + beyond;
        // Also finite for NaN coordinates.
        const F x = select(raw > low_end, select(raw < high_end, raw, high_end), low_end);
        slope = select(x == raw, sides, all<F>(0.0f));
        const F low = floor_of(nearest ? x + 0.5f : x);
        part[1] = nearest ? all<F>(0.0f) : x - low, part[0] = 1.0f - part[1];
        Ints first = to_ints(low);
        if (nearest && boundary != ZERO) {
            first = select(first < size, first, size - 1);
            first = select(first > 0, first, Ints{});
        }
        for (int k = 0; k < 2; ++k) {
            Ints n = first + k;
            if (boundary == WRAP) n = select(n < 0, n + size, select(n >= size, n - size, n));
            if (boundary == CLAMP) n = select(n >= size, size - 1, n);
            texel[k] = n;
        }
    }
};

}  // namespace nr
