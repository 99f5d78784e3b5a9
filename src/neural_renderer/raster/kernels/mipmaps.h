// Textures with mipmaps: trilinear samples (Williams, "Pyramidal parametrics", 1983), and their gradient.
#pragma once

#include "lanes.h"
#include "tasks.h"
#include "texel_pair.h"

namespace nr {

struct Mipmaps {
    const float* texels;  // each level after the larger one, [owners, total, channels]
    int64 total;          // texels of all levels
    int owners;           // images of texels; 1 if all share them
    int channels;
    int height, width;       // texels of the largest level
    int levels;              // 1 without mipmaps
    int repeat_u, repeat_v;  // whether the image repeats beyond [0, 1]; else its border is extended

    NR_FUNC int64 start(int image) const { return shared(image, owners) * total * channels; }
};

struct Samples {
    const vec2* uv;         // texture coordinates, u to the right, v up, [images, height, width]
    const int* face_index;  // [images, height, width]
    int images, height, width;
    int each;  // rows of a task
};

// The four texels of a level around a point.
struct TexelBlock {
    int64 first;  // place of the level's first texel
    int64 width;  // texels of a row of the level
    TexelPair x, y;
    float share;  // share of the level in the sample

    NR_FUNC int64 texel(int down, int right) const { return first + y.texel[down] * width + x.texel[right]; }
};

NR_FUNC TexelBlock block_of_level(const Mipmaps& maps, vec2 uv, int level, float share) {
    int width = maps.width, height = maps.height;
    int64 before = 0;
    for (int k = 0; k < level; ++k) {
        before += (int64)width * height;
        width = width > 1 ? width >> 1 : 1, height = height > 1 ? height >> 1 : 1;
    }
    const TexelPair x(uv[0], width, maps.repeat_u ? WRAP : CLAMP);
    const TexelPair y(1.0f - uv[1], height, maps.repeat_v ? WRAP : CLAMP);
    return {before, width, x, y, share};
}

// The change of uv to the next pixel, or from the previous one; 0 if neither shows the same face.
NR_FUNC vec2 change_of_uv(const vec2* uv, const int* shown, bool next, bool previous, int64 step) {
    if (next && shown[step] == shown[0]) return {uv[step][0] - uv[0][0], uv[step][1] - uv[0][1]};
    if (previous && shown[-step] == shown[0]) return {uv[0][0] - uv[-step][0], uv[0][1] - uv[-step][1]};
    return {0.0f, 0.0f};
}

// log2 of the texels along the longer side of pixel i of row j from the top, clamped to the levels.
NR_FUNC float level_at(const Mipmaps& maps, const Samples& samples, int64 pixel, int i, int j) {
    if (maps.levels == 1) return 0.0f;
    const vec2* uv = samples.uv + pixel;
    const int* shown = samples.face_index + pixel;
    const vec2 x = change_of_uv(uv, shown, i + 1 < samples.width, i > 0, 1);
    const vec2 y = change_of_uv(uv, shown, j + 1 < samples.height, j > 0, samples.width);
    const float w = (float)maps.width, h = (float)maps.height;
    const float across = x[0] * x[0] * w * w + x[1] * x[1] * h * h;
    const float down = y[0] * y[0] * w * w + y[1] * y[1] * h * h;
    const float longest = across > down ? across : down;
    if (!(longest > 1.0f)) return 0.0f;
    const float chosen = 0.5f * log2f(longest), last = (float)(maps.levels - 1);
    return chosen < last ? chosen : last;
}

// Call visit(block) for each level, at most two, that the sample at a pixel has a share of.
template <class Visit>
NR_FUNC void for_each_level(const Mipmaps& maps, const Samples& samples, int64 pixel, int i, int j, Visit visit) {
    const float chosen = level_at(maps, samples, pixel, i, j);
    const int low = (int)chosen;
    for (int n = low; n < low + 2 && n < maps.levels; ++n) {
        const float share = n == low ? 1.0f - (chosen - (float)low) : chosen - (float)low;
        if (share > 0.0f) visit(block_of_level(maps, samples.uv[pixel], n, share));
    }
}

// Call visit(image, pixel, i, j) for the pixels of a task; rows j count from the top.
template <class Visit>
NR_FUNC void for_each_sample(const Samples& samples, int task, Visit visit) {
    const int height = samples.height, width = samples.width;
    const Pixels pixels = pixels_of_task(task, samples.each, samples.images * height, width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) visit(row / height, (int64)row * width + i, i, row % height);
}

struct SampleMipmaps {
    Mipmaps maps;
    Samples samples;
    float* result;  // [images, height, width, channels], 0 where no face is visible
};

// Add a level's colours; ``channels`` apart from the call's, so that it may be known to the compiler.
NR_FUNC void blend_block(const TexelBlock& block, const float* image, int channels, float* __restrict__ color) {
    const float *x = block.x.part, *y = block.y.part;
    const float* __restrict__ above[2] = {image + block.texel(0, 0) * channels, image + block.texel(0, 1) * channels};
    const float* __restrict__ below[2] = {image + block.texel(1, 0) * channels, image + block.texel(1, 1) * channels};
    const float up = block.share * y[0], down = block.share * y[1];
    for (int c = 0; c < channels; ++c)
        color[c] += up * (x[0] * above[0][c] + x[1] * above[1][c]) + down * (x[0] * below[0][c] + x[1] * below[1][c]);
}

#if NR_LANES
// The four texels of a block, of three channels each, as vectors: two of the row above and two of the one below.
struct FourTexels {
    floats4 above[2], below[2];

    FourTexels(const TexelBlock& block, const vec3* image) {
        for (int k = 0; k < 2; ++k)
            above[k] = as_vector(image[block.texel(0, k)]), below[k] = as_vector(image[block.texel(1, k)]);
    }
};
#endif

// The colour of a pixel that shows a face, of three channels, the usual number.
NR_FUNC vec3 sample_rgb(const SampleMipmaps& call, const float* image, int64 pixel, int i, int j) {
    vec3 color = {};
    for_each_level(call.maps, call.samples, pixel, i, j, [&](const TexelBlock& block) {
#if NR_LANES
        const FourTexels texels(block, (const vec3*)image);
        const float *x = block.x.part, *y = block.y.part, up = block.share * y[0], down = block.share * y[1];
        color += as_vec3(
            up * (x[0] * texels.above[0] + x[1] * texels.above[1])
            + down * (x[0] * texels.below[0] + x[1] * texels.below[1]));
#else
        blend_block(block, image, 3, color.c);
#endif
    });
    return color;
}

// The pixels of a task.
NR_FUNC void sample_mipmaps(const SampleMipmaps& call, int task) {
    const int channels = call.maps.channels;
    for_each_sample(call.samples, task, [&](int b, int64 pixel, int i, int j) {
        float* color = call.result + pixel * channels;
        for (int c = 0; c < channels; ++c) color[c] = 0.0f;
        if (call.samples.face_index[pixel] < 0) return;
        const float* image = call.maps.texels + call.maps.start(b);
        if (channels == 3) {
            *(vec3*)color = sample_rgb(call, image, pixel, i, j);
            return;
        }
        for_each_level(call.maps, call.samples, pixel, i, j, [&](const TexelBlock& block) {
            blend_block(block, image, channels, color);
        });
    });
}

// The slope of a value along rows of texels, which run down, and along columns, by the values of a block's texels.
NR_FUNC vec2 slope_of_block(const TexelBlock& block, const float* values) {
    const float *x = block.x.part, *y = block.y.part;
    return {
        (y[0] * (values[1] - values[0]) + y[1] * (values[3] - values[2])) * block.x.slope,
        (x[0] * (values[2] - values[0]) + x[1] * (values[3] - values[1])) * block.y.slope};
}

struct SampleMipmapsBackward {
    Mipmaps maps;
    Samples samples;
    const float* grad;  // [images, height, width, channels]
    int texels_too;     // whether the gradient to texels is asked for
    float* to_texels;   // [owners, total, channels], 0 before
    vec2* to_uv;        // [images, height, width], 0 before
};

// Send a level's gradients to its texels, unless ``to`` is null, and to the place in it. On the CPU
// one task writes an image's texels.
NR_FUNC void blend_block_backward(
    const TexelBlock& block, const float* image, int channels, const float* pull, float* to, vec2& to_uv) {
    const float *x = block.x.part, *y = block.y.part;
    const int64 above[2] = {block.texel(0, 0) * channels, block.texel(0, 1) * channels};
    const int64 below[2] = {block.texel(1, 0) * channels, block.texel(1, 1) * channels};
    float gain[4] = {0.0f, 0.0f, 0.0f, 0.0f};  // gradient with respect to each texel's weight
    for (int c = 0; c < channels; ++c) {
        const float g = block.share * pull[c];
        gain[0] += g * image[above[0] + c], gain[1] += g * image[above[1] + c];
        gain[2] += g * image[below[0] + c], gain[3] += g * image[below[1] + c];
        if (!to) continue;
        add_product(to + above[0] + c, g * y[0], x[0]);
        add_product(to + above[1] + c, g * y[0], x[1]);
        add_product(to + below[0] + c, g * y[1], x[0]);
        add_product(to + below[1] + c, g * y[1], x[1]);
    }
    const vec2 slope = slope_of_block(block, gain);
    to_uv[0] += slope[0], to_uv[1] += slope[1];
}

// The pixels of a task.
NR_FUNC void sample_mipmaps_backward(const SampleMipmapsBackward& call, int task) {
    const int channels = call.maps.channels;
    for_each_sample(call.samples, task, [&](int b, int64 pixel, int i, int j) {
        if (call.samples.face_index[pixel] < 0) return;
        const float *image = call.maps.texels + call.maps.start(b), *pull = call.grad + pixel * channels;
        float* to = call.texels_too ? call.to_texels + call.maps.start(b) : nullptr;
        vec2 to_uv = {0.0f, 0.0f};  // gradient along rows of texels, which run down
        for_each_level(call.maps, call.samples, pixel, i, j, [&](const TexelBlock& block) {
#if NR_LANES
            if (channels == 3) {  // the usual number
                const FourTexels texels(block, (const vec3*)image);
                const float *x = block.x.part, *y = block.y.part;
                const floats4 g = block.share * as_vector(*(const vec3*)pull);
                const floats4 right =
                    y[0] * (texels.above[1] - texels.above[0]) + y[1] * (texels.below[1] - texels.below[0]);
                const floats4 down =
                    x[0] * (texels.below[0] - texels.above[0]) + x[1] * (texels.below[1] - texels.above[1]);
                to_uv[0] += dot(as_vec3(g), as_vec3(right)) * block.x.slope;
                to_uv[1] += dot(as_vec3(g), as_vec3(down)) * block.y.slope;
                for (int n = 0; n < 4 && to; ++n) {
                    vec3* texel = (vec3*)to + block.texel(n >> 1, n & 1);
                    *texel = as_vec3(as_vector(*texel) + g * y[n >> 1] * x[n & 1]);
                }
                return;
            }
#endif
            if (channels == 3) blend_block_backward(block, image, 3, pull, to, to_uv);
            else blend_block_backward(block, image, channels, pull, to, to_uv);
        });
        call.to_uv[pixel] = {to_uv[0], -to_uv[1]};
    });
}

// The change of samples while their coordinates move in each of several directions.
struct SampleMipmapsForward {
    Mipmaps maps;
    Samples samples;
    const vec2* motion;  // change of the coordinates, [directions, images, height, width]
    int directions;
    float* change;  // [directions, images, height, width, channels], 0 before
};

// The pixels of a task.
NR_FUNC void sample_mipmaps_forward(const SampleMipmapsForward& call, int task) {
    const int channels = call.maps.channels;
    const int64 pixels = (int64)call.samples.images * call.samples.height * call.samples.width;
    for_each_sample(call.samples, task, [&](int b, int64 pixel, int i, int j) {
        if (call.samples.face_index[pixel] < 0) return;
        const float* image = call.maps.texels + call.maps.start(b);
        for_each_level(call.maps, call.samples, pixel, i, j, [&](const TexelBlock& block) {
            int64 places[4];
            for (int n = 0; n < 4; ++n) places[n] = block.texel(n >> 1, n & 1) * channels;
            for (int c = 0; c < channels; ++c) {
                float values[4];
                for (int n = 0; n < 4; ++n) values[n] = block.share * image[places[n] + c];
                const vec2 slope = slope_of_block(block, values);
                for (int t = 0; t < call.directions; ++t) {
                    const vec2& by = call.motion[t * pixels + pixel];
                    call.change[(t * pixels + pixel) * channels + c] += slope[0] * by[0] - slope[1] * by[1];
                }
            }
        });
    });
}

}  // namespace nr
