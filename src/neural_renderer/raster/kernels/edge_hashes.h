// Hashes of the colours along each edge of a face, which tell whether the colour is continuous across it.
#pragma once

#include "cube.h"

namespace nr {

typedef unsigned long long uint64;

// The golden ratio in 64 bits, whose powers have well-mixed bits, and two odd numbers, for both directions of an edge.
constexpr uint64 ODD = 0x9E3779B97F4A7C15ull, THERE = 0x2545F4914F6CDD1Dull, BACK = 0x5851F42D4C957F2Dull;

struct HashEdges {
    Scene scene;  // its number of faces alone
    LitCubes textures;
    int64* hashes;  // [images, count, 3, 2]: of edge k, from corner k to the next, in this direction and in the other
};

// Mix the high bits into the low ones.
NR_FUNC uint64 mixed(uint64 n) {
    n = (n ^ (uint64)((int64)n >> 32)) * ODD;
    return n ^ (uint64)((int64)n >> 29);
}

// Add a colour to a hash, rounded to 12 of its 23 mantissa bits: one part in 4000.
NR_FUNC uint64 add_color(uint64 hash, const vec3& color) {
    for (int c = 0; c < 3; ++c) {
        const int bits = bits_of(color[c] + 0.0f);  // -0 is 0
        hash = (hash + (uint64)(int64)((int)((unsigned)bits + 1024u) >> 11)) * ODD;
    }
    return hash;
}

// The edges of one face of one image: the texels, or corners, that are blended on them, under the light on both sides.
NR_FUNC void hash_edges(const HashEdges& call, int task) {
    const LitCubes& textures = call.textures;
    const int b = task / call.scene.count, f = task % call.scene.count, size = textures.size;
    int64* to = call.hashes + (int64)task * 6;
    if (!textures.has(b, f)) {
        for (int n = 0; n < 6; ++n) to[n] = 0;
        return;
    }
    const vec3* cube = textures.cube(call.scene, b, f);
    const vec3 &front = textures.light_on(call.scene, b, f, 0), &back = textures.light_on(call.scene, b, f, 1);
    const uint64 light = mixed(add_color(add_color(0, front), back));
    // Steps from texel to texel along the axis of the edge's first corner, and of its second.
    const int64 square = (int64)size * size, along[3] = {square, size, 1}, beside[3] = {size, 1, square};
    for (int k = 0; k < 3; ++k) {
        uint64 hashes[2] = {0, 0};
        if (size == 0) {
            const uint64 first = mixed(add_color(0, cube[k])), second = mixed(add_color(0, cube[(k + 1) % 3]));
            hashes[0] = mixed(first + THERE) + mixed(second + BACK);
            hashes[1] = mixed(first + BACK) + mixed(second + THERE);
        }
        for (int i = 0; i < size; ++i)
            for (int j = larger(size - 2 - i, 0); j <= smaller(size - i, size - 1); ++j) {
                const uint64 color = mixed(add_color(0, cube[i * along[k] + j * beside[k]]));
                hashes[0] += mixed(color + (uint64)i * THERE + (uint64)j * BACK);
                hashes[1] += mixed(color + (uint64)j * THERE + (uint64)i * BACK);
            }
        for (int n = 0; n < 2; ++n, ++to) {
            *to = (int64)(hashes[n] + light);
            if (*to == 0) *to = 1;  // 0 matches nothing
        }
    }
}

}  // namespace nr
