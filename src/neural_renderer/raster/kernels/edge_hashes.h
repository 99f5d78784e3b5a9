// Hashes of the colours along each edge of a face: equal hashes mean that the colour is continuous across the edge.
#pragma once

#include "cube.h"

namespace nr {

// The golden ratio in 64 bits, whose powers have well-mixed bits (Knuth, "The art of computer programming", volume 3,
// section 6.4), and an odd number for each direction of an edge.
constexpr uint64 ODD = 0x9E3779B97F4A7C15ull, THERE = 0x2545F4914F6CDD1Dull, BACK = 0x5851F42D4C957F2Dull;

struct HashEdges {
    Scene scene;  // only its number of faces
    LitCubes textures;
    int64* hashes;  // [images, count, 3, 2]: edge k, from corner k to the next, forwards and backwards
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

// The hash of the light on both sides of a face.
NR_FUNC uint64 hash_light(const vec3& front, const vec3& back) { return mixed(add_color(add_color(0, front), back)); }
NR_FUNC uint64 hash_light(const Scene& scene, const LitCubes& textures, int image, int f) {
    return hash_light(textures.light_on(scene, image, f, 0), textures.light_on(scene, image, f, 1));
}

// Store a hash; 0 never matches.
NR_FUNC void store_hash(int64* to, uint64 hash) { *to = hash == 0 ? 1 : (int64)hash; }

// The hashes of edge k of a face, forwards and backwards, over the texels, or corner colours, that are blended on it.
struct EdgeHash {
    uint64 there = 0, back = 0;

    NR_FUNC EdgeHash(const Scene& scene, const LitCubes& textures, int image, int f, int k) {
        const vec3* cube = textures.cube(scene, image, f);
        const int size = textures.size;
        if (size == 0) {
            const uint64 first = mixed(add_color(0, cube[k])), second = mixed(add_color(0, cube[(k + 1) % 3]));
            there = mixed(first + THERE) + mixed(second + BACK);
            back = mixed(first + BACK) + mixed(second + THERE);
        }
        // Strides from texel to texel along the axis of the edge's first corner and of its second.
        const int64 square = (int64)size * size;
        const int64 along = k == 0 ? square : k == 1 ? size : 1, across = k == 0 ? size : k == 1 ? 1 : square;
        for (int i = 0; i < size; ++i)
            for (int j = max(size - 2 - i, 0); j <= min(size - i, size - 1); ++j) {
                const uint64 color = mixed(add_color(0, cube[i * along + j * across]));
                there += mixed(color + (uint64)i * THERE + (uint64)j * BACK);
                back += mixed(color + (uint64)j * THERE + (uint64)i * BACK);
            }
    }
};

// Whether the lit colours along edge k of face f equal those along edge m of face g, in the opposite direction.
NR_FUNC bool same_colors(const Scene& scene, const LitCubes& textures, int image, int f, int k, int g, int m) {
    if (!textures.has(image, f) || !textures.has(image, g)) return false;
    return hash_light(scene, textures, image, f) == hash_light(scene, textures, image, g)
        && EdgeHash(scene, textures, image, f, k).there == EdgeHash(scene, textures, image, g, m).back;
}

// Hash the edges of one face of one image, under light.
NR_FUNC void hash_edges(const HashEdges& call, int task) {
    const int b = task / call.scene.count, f = task % call.scene.count;
    int64* to = call.hashes + (int64)task * 6;
    const bool known = call.textures.has(b, f);
    const uint64 light = known ? hash_light(call.scene, call.textures, b, f) : 0;
    for (int k = 0; k < 3; ++k, to += 2) {
        to[0] = to[1] = 0;
        if (!known) continue;
        const EdgeHash hash(call.scene, call.textures, b, f, k);
        store_hash(to, hash.there + light), store_hash(to + 1, hash.back + light);
    }
}

struct LitHashes {
    const int64* hashes;  // of edges without light, [owners, count, 3, 2]
    const vec3* light;    // factors on the front and the back of each face, [lamps, 2, count]
    int owners, lamps, count;
    int64* lit;  // [images, count, 3, 2]
};

// Add the hash of the light to those of the edges of one face of one image.
NR_FUNC void add_light(const LitHashes& call, int task) {
    const int b = task / call.count, f = task % call.count;
    const vec3* light = call.light + (int64)broadcast(b, call.lamps) * 2 * call.count + f;
    const uint64 hash = hash_light(light[0], light[call.count]);
    const int64* from = call.hashes + ((int64)broadcast(b, call.owners) * call.count + f) * 6;
    for (int n = 0; n < 6; ++n) store_hash(call.lit + (int64)task * 6 + n, (uint64)from[n] + hash);
}

}  // namespace nr
