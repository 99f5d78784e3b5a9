// Trilinear sampling of mipmaps (Williams, "Pyramidal parametrics", 1983), and its gradient.
//
// `texture_levels.h` samples in the same way with a given footprint, cube maps and more filters. They are not one:
// eight lanes make this one about five times as fast, and its order of products gives other bits.
#pragma once

#include "lanes.h"
#include "tasks.h"
#include "texel_pair.h"

namespace nr {

struct Mipmaps {
    const float* texels;  // all levels, the largest first, [owners, total, channels]
    int64 total;          // texels of all levels
    int owners;           // images of texels; 1 if all share them
    int channels;
    int height, width;       // texels of the largest level
    int levels;              // 1 without mipmaps
    int repeat_u, repeat_v;  // whether the image repeats beyond [0, 1]; else its border is extended

    NR_FUNC int64 start(int image) const { return broadcast(image, owners) * total * channels; }
};

struct Samples {
    const vec2* uv;         // texture coordinates, u to the right, v up, [images, height, width]
    const int* face_index;  // [images, height, width]
    int images, height, width;
    int each;  // rows of a task
};

// The four texels of a level around a sample.
struct TexelBlock {
    int64 texel[4];    // offsets: upper row, then lower row
    float x[2], y[2];  // weights of the columns and of the rows
    vec2 slope;        // derivative of the position in texels by the coordinate
    float share;       // weight of the level in the sample
};

// The blocks of several samples, each at its own level.
template <class F>
struct TexelBlocks {
    typedef typename Lanes<F>::Ints Ints;
    typedef typename Lanes<F>::Places Places;
    typedef decltype(lane(Places{}, 0)) Place;
    Places texel[4];
    F x[2], y[2], slope[2], share;

    NR_FUNC void set(const Mipmaps& maps, const F* uv, Ints level, F part) {
        const Ints width = halved(maps.width, level);
        const TexelPair<F> across(uv[0], width, maps.repeat_u ? WRAP : CLAMP);
        const TexelPair<F> down(1.0f - uv[1], halved(maps.height, level), maps.repeat_v ? WRAP : CLAMP);
        Places first = {};
        for (int k = 0; any(level > k); ++k) {
            const Places before = Places{} + (Place)max(maps.width >> k, 1) * max(maps.height >> k, 1);
            first += select(level > k, before, Places{});
        }
        for (int n = 0; n < 4; ++n) texel[n] = first + (Places{} + down.texel[n >> 1]) * width + across.texel[n & 1];
        for (int k = 0; k < 2; ++k) x[k] = across.part[k], y[k] = down.part[k];
        slope[0] = across.slope, slope[1] = down.slope, share = part;
    }
    NR_FUNC Ints halved(int side, Ints times) const {
        const Ints half = (Ints{} + side) >> times;
        return select(half > 0, half, Ints{} + 1);
    }
};

// The blocks of one sample: at most two levels; none where no face is visible.
template <class F>
struct BlocksOfSample {
    const TexelBlocks<F>* blocks;
    int n, levels;

    NR_FUNC TexelBlock operator[](int level) const {
        const TexelBlocks<F>& all = blocks[level];
        TexelBlock block;
        for (int k = 0; k < 4; ++k) block.texel[k] = lane_in_memory(all.texel[k], n);
        for (int k = 0; k < 2; ++k) block.x[k] = lane_in_memory(all.x[k], n), block.y[k] = lane_in_memory(all.y[k], n);
        for (int k = 0; k < 2; ++k) block.slope[k] = lane_in_memory(all.slope[k], n);
        block.share = lane_in_memory(all.share, n);
        return block;
    }
};

// The finite difference of uv to the next pixel, else to the previous one; 0 if neither shows the same face.
template <class F>
NR_FUNC void change_of_uv(const vec2* uv, const int* shown, bool next, bool previous, int64 step, F* change) {
    typedef typename Lanes<F>::Ints Ints;
    const Ints face = load<Ints>(shown);
    F here[2], other[2];
    load(uv, here);
    change[0] = change[1] = all<F>(0.0f);
    if (previous) {
        load(uv - step, other);
        const auto same = load<Ints>(shown - step) == face;
        for (int k = 0; k < 2; ++k) change[k] = select(same, here[k] - other[k], change[k]);
    }
    if (next) {
        load(uv + step, other);
        const auto same = load<Ints>(shown + step) == face;
        for (int k = 0; k < 2; ++k) change[k] = select(same, other[k] - here[k], change[k]);
    }
}

// The level: log2 of the texels along the longer side of a pixel, clamped; for pixels from i on in row j from the top.
template <class F>
NR_FUNC F level_at(const Mipmaps& maps, const Samples& samples, int64 pixel, int i, int j) {
    F chosen = all<F>(0.0f);
    if (maps.levels == 1) return chosen;
    const vec2* uv = samples.uv + pixel;
    const int* shown = samples.face_index + pixel;
    F x[2], y[2];
    change_of_uv(uv, shown, i + Lanes<F>::WIDTH < samples.width, i > 0, 1, x);
    change_of_uv(uv, shown, j + 1 < samples.height, j > 0, samples.width, y);
    const float w = (float)maps.width, h = (float)maps.height, last = (float)(maps.levels - 1);
    const F across = x[0] * x[0] * w * w + x[1] * x[1] * h * h;
    const F down = y[0] * y[0] * w * w + y[1] * y[1] * h * h;
    const F longest = select(across > down, across, down);
    for (int n = 0; n < Lanes<F>::WIDTH; ++n)
        if (lane(longest, n) > 1.0f) set_lane(chosen, n, 0.5f * log2f(lane(longest, n)));
    return select(chosen < last, chosen, all<F>(last));
}

// Call visit(pixel, sample) with the `BlocksOfSample` of contiguous pixels.
template <class F, class Visit>
NR_FUNC void visit_samples(const Mipmaps& maps, const Samples& samples, int64 pixel, int i, int j, Visit visit) {
    typedef typename Lanes<F>::Ints Ints;
    TexelBlocks<F> blocks[2];
    const int* shown = samples.face_index + pixel;
    F share = all<F>(0.0f);
    if (any(load<Ints>(shown) >= 0)) {
        F uv[2];
        load(samples.uv + pixel, uv);
        const F chosen = level_at<F>(maps, samples, pixel, i, j);
        const Ints low = to_ints(chosen);
        share = chosen - to_floats(low);
        blocks[0].set(maps, uv, low, 1.0f - share);
        if (any(share > 0.0f)) blocks[1].set(maps, uv, low + 1, share);
    }
    for (int n = 0; n < Lanes<F>::WIDTH; ++n) {
        const int levels = shown[n] < 0 ? 0 : lane(share, n) > 0.0f ? 2 : 1;
        visit(pixel + n, BlocksOfSample<F>{blocks, n, levels});
    }
}

// Call visit(image, pixel, sample) for the pixels of a task.
template <class Visit>
NR_FUNC void for_each_sample(const Mipmaps& maps, const Samples& samples, int task, Visit visit) {
    const int height = samples.height, width = samples.width;
    const Pixels pixels = pixels_of_task(task, samples.each, samples.images * height, width);
    for (int row = pixels.first; row < pixels.last; ++row) {
        const auto one = [&](int64 pixel, const auto& sample) { visit(row / height, pixel, sample); };
        const int64 first = (int64)row * width;
        for (int i = pixels.left; i < pixels.right; ++i) {
#if NR_LANES
            // All eight pixels have both neighbours in the row, and texel offsets fit into 32 bits.
            for (; i > 0 && i + 8 < width && maps.total < (1LL << 31); i += 8)
                visit_samples<floats8>(maps, samples, first + i, i, row % height, one);
#endif
            visit_samples<float>(maps, samples, first + i, i, row % height, one);
        }
    }
}

struct SampleMipmaps {
    Mipmaps maps;
    Samples samples;
    float* result;  // [images, height, width, channels], 0 where no face is visible
};

// Add the colours of a level; ``channels`` is an argument, so that it may be a constant for the compiler.
NR_FUNC void blend_block(const TexelBlock& block, const float* image, int channels, float* __restrict__ color) {
    const float up = block.share * block.y[0], down = block.share * block.y[1];
    const float* texel[4];
    for (int n = 0; n < 4; ++n) texel[n] = image + block.texel[n] * channels;
    for (int c = 0; c < channels; ++c)
        color[c] += up * (block.x[0] * texel[0][c] + block.x[1] * texel[1][c])
            + down * (block.x[0] * texel[2][c] + block.x[1] * texel[3][c]);
}

#if NR_LANES
// The four texels of a block, of three channels each, as vectors.
struct FourTexels {
    floats4 above[2], below[2];

    FourTexels(const TexelBlock& block, const vec3* image) {
        for (int k = 0; k < 2; ++k)
            above[k] = as_vector(image[block.texel[k]]), below[k] = as_vector(image[block.texel[2 + k]]);
    }
    // Derivatives of the channels along rows of texels, and along columns, which run down.
    floats4 across(const TexelBlock& block) const {
        const float* y = block.y;
        return block.slope[0] * (y[0] * (above[1] - above[0]) + y[1] * (below[1] - below[0]));
    }
    floats4 along(const TexelBlock& block) const {
        const float* x = block.x;
        return block.slope[1] * (x[0] * (below[0] - above[0]) + x[1] * (below[1] - above[1]));
    }
};
#endif

// The colour of a pixel with three channels, the usual case.
template <class F>
NR_FUNC vec3 sample_rgb(const float* image, const BlocksOfSample<F>& sample) {
#if NR_LANES
    floats4 color = {};
    for (int k = 0; k < sample.levels; ++k) {
        const TexelBlock block = sample[k];
        const FourTexels texels(block, (const vec3*)image);
        const float *x = block.x, up = block.share * block.y[0], down = block.share * block.y[1];
        color += up * (x[0] * texels.above[0] + x[1] * texels.above[1])
            + down * (x[0] * texels.below[0] + x[1] * texels.below[1]);
    }
    return as_vec3(color);
#else
    vec3 color = {};
    for (int k = 0; k < sample.levels; ++k) blend_block(sample[k], image, 3, color.c);
    return color;
#endif
}

// The pixels of a task.
NR_FUNC void sample_mipmaps(const SampleMipmaps& call, int task) {
    const int channels = call.maps.channels;
    for_each_sample(call.maps, call.samples, task, [&](int b, int64 pixel, const auto& sample) {
        const float* image = call.maps.texels + call.maps.start(b);
        float* color = call.result + pixel * channels;
        if (channels == 3) {
            *(vec3*)color = sample_rgb(image, sample);
            return;
        }
        for (int c = 0; c < channels; ++c) color[c] = 0.0f;
        for (int k = 0; k < sample.levels; ++k) blend_block(sample[k], image, channels, color);
    });
}

// The derivative of a blended value along rows of texels and along columns, which run down.
NR_FUNC vec2 slope_of_block(const TexelBlock& block, const float* values) {
    const float *x = block.x, *y = block.y;
    return {
        (y[0] * (values[1] - values[0]) + y[1] * (values[3] - values[2])) * block.slope[0],
        (x[0] * (values[2] - values[0]) + x[1] * (values[3] - values[1])) * block.slope[1]};
}

struct SampleMipmapsBackward {
    Mipmaps maps;
    Samples samples;
    const float* grad;  // [images, height, width, channels]
    int texels_too;     // whether the gradient to texels is needed
    float* to_texels;   // [owners, total, channels], 0 before
    vec2* to_uv;        // [images, height, width]
};

// Propagate the gradient of a level to its texels, unless ``to`` is null, and to the coordinates. On the CPU only one
// task writes the texels of an image.
NR_FUNC void blend_block_backward(
    const TexelBlock& block, const float* image, int channels, const float* cotangent, float* to, vec2& to_uv) {
    float gain[4] = {0.0f, 0.0f, 0.0f, 0.0f};  // gradient with respect to each texel's weight
    for (int c = 0; c < channels; ++c) {
        const float g = block.share * cotangent[c];
        for (int n = 0; n < 4; ++n) {
            const int64 place = block.texel[n] * channels + c;
            gain[n] += g * image[place];
            if (to) add_product(to + place, g * block.y[n >> 1], block.x[n & 1]);
        }
    }
    const vec2 slope = slope_of_block(block, gain);
    to_uv[0] += slope[0], to_uv[1] += slope[1];
}

#if NR_LANES
// Likewise for three channels.
inline void blend_rgb_backward(
    const TexelBlock& block, const vec3* image, const vec3& cotangent, vec3* to, vec2& to_uv) {
    const FourTexels texels(block, image);
    const float *x = block.x, *y = block.y;
    const floats4 g = block.share * as_vector(cotangent);
    to_uv[0] += dot(as_vec3(g), as_vec3(texels.across(block)));
    to_uv[1] += dot(as_vec3(g), as_vec3(texels.along(block)));
    for (int n = 0; n < 4 && to; ++n) {
        vec3* texel = to + block.texel[n];
        *texel = as_vec3(as_vector(*texel) + g * y[n >> 1] * x[n & 1]);
    }
}
#endif

// The pixels of a task.
NR_FUNC void sample_mipmaps_backward(const SampleMipmapsBackward& call, int task) {
    const int channels = call.maps.channels;
    for_each_sample(call.maps, call.samples, task, [&](int b, int64 pixel, const auto& sample) {
        const float *image = call.maps.texels + call.maps.start(b), *cotangent = call.grad + pixel * channels;
        float* to = call.texels_too ? call.to_texels + call.maps.start(b) : nullptr;
        vec2 to_uv = {0.0f, 0.0f};  // gradient along rows of texels, which run down
        for (int k = 0; k < sample.levels; ++k) {
#if NR_LANES
            if (channels == 3) {  // the usual case
                blend_rgb_backward(sample[k], (const vec3*)image, *(const vec3*)cotangent, (vec3*)to, to_uv);
                continue;
            }
#endif
            if (channels == 3) blend_block_backward(sample[k], image, 3, cotangent, to, to_uv);
            else blend_block_backward(sample[k], image, channels, cotangent, to, to_uv);
        }
        call.to_uv[pixel] = {to_uv[0], 0.0f - to_uv[1]};
    });
}

// Tangents of samples for several tangents of their coordinates.
struct SampleMipmapsForward {
    Mipmaps maps;
    Samples samples;
    const vec2* motion;  // change of the coordinates, [directions, images, height, width]
    int directions;
    float* change;  // [directions, images, height, width, channels]
};

// Call visit(change, motion) for each direction: the address of a pixel's tangent, and the tangent of its coordinates.
template <class Visit>
NR_FUNC void for_each_direction(const SampleMipmapsForward& call, int64 pixel, Visit visit) {
    const Samples& samples = call.samples;
    const int64 pixels = (int64)samples.images * samples.height * samples.width;
    const bool shown = samples.face_index[pixel] >= 0;  // elsewhere coordinates are undefined
    for (int t = 0; t < call.directions; ++t, pixel += pixels)
        visit(call.change + pixel * call.maps.channels, shown ? call.motion[pixel] : vec2{0.0f, 0.0f});
}

// The pixels of a task.
NR_FUNC void sample_mipmaps_forward(const SampleMipmapsForward& call, int task) {
    const int channels = call.maps.channels;
    for_each_sample(call.maps, call.samples, task, [&](int b, int64 pixel, const auto& sample) {
        const float* image = call.maps.texels + call.maps.start(b);
#if NR_LANES
        if (channels == 3) {  // the usual case
            floats4 across = {}, along = {};
            for (int k = 0; k < sample.levels; ++k) {
                const TexelBlock block = sample[k];
                const FourTexels texels(block, (const vec3*)image);
                across += block.share * texels.across(block), along += block.share * texels.along(block);
            }
            for_each_direction(call, pixel, [&](float* change, const vec2& by) {
                *(vec3*)change = as_vec3(across * by[0] - along * by[1]);
            });
            return;
        }
#endif
        for (int c = 0; c < channels; ++c) {
            vec2 slope = {0.0f, 0.0f};
            for (int k = 0; k < sample.levels; ++k) {
                const TexelBlock block = sample[k];
                float values[4];
                for (int n = 0; n < 4; ++n) values[n] = block.share * image[block.texel[n] * channels + c];
                const vec2 part = slope_of_block(block, values);
                slope[0] += part[0], slope[1] += part[1];
            }
            for_each_direction(
                call, pixel, [&](float* change, const vec2& by) { change[c] = slope[0] * by[0] - slope[1] * by[1]; });
        }
    });
}

}  // namespace nr
