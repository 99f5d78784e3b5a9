// Sampling of images and cube maps with a given footprint and mipmaps (Williams, "Pyramidal parametrics", 1983), and
// the gradient to texels, coordinates, footprints and levels.
//
// The first texel in memory lies at (s, t) = (0, 0). A cube map has six faces, +x, -x, +y, -y, +z, -z; OpenGL's table
// of major axes gives s and t of a direction (The OpenGL Graphics System, version 4.6, table 8.19).
#pragma once

#include "tasks.h"
#include "texel_pair.h"

namespace nr {

// The filters. Python reads their numbers from here.
constexpr int FILTER_NEAREST = 0, FILTER_LINEAR = 1, FILTER_NEAREST_LEVEL = 2, FILTER_LINEAR_LEVELS = 3;

struct TextureLevels {
    const float* texels;  // all levels, the largest first, [owners, total, channels]
    int64 total;          // texels of all levels
    int owners;           // images of texels; 1 if all share them
    int channels;
    int height, width;  // texels of the largest level
    int levels;
    int filter;
    int boundary, boundary_t;  // along s and along t; a cube map has one

    NR_FUNC int64 start(int image) const { return broadcast(image, owners) * total * channels; }
    NR_FUNC int sides() const { return boundary == CUBE ? 6 : 1; }
};

struct Lookups {
    const float* uv;         // (s, t), or a direction for a cube map, [images, height, width, 2 or 3]
    const float* footprint;  // change of each by one pixel, right and up in turn, [..., 4 or 6]; may be null
    const float* bias;       // added to the level, [images, height, width]; may be null
    int images, height, width;
    int each;  // rows of a task
};

// Texture coordinates on an image or on a face of a cube map.
struct TextureCoordinate {
    float s, t;
    int face;                         // -1 for a direction of length 0
    int major, across, up;            // components of the direction along which depth, s and t run
    float forth, right, upwards;      // their signs
    float inverse, ratio_s, ratio_t;  // 1 / depth, and s and t in [-1, 1]

    NR_FUNC static TextureCoordinate of_image(const float* uv) {
        return {uv[0], uv[1], 0, 0, 0, 1, 1.0f, 1.0f, 1.0f, 0.0f, 0.0f, 0.0f};
    }
    NR_FUNC static TextureCoordinate of_direction(const float* d) {
        const float x = fabsf(d[0]), y = fabsf(d[1]), z = fabsf(d[2]);
        TextureCoordinate coordinate = {};
        coordinate.major = x >= y && x >= z ? 0 : y >= z ? 1 : 2;
        const float depth = fabsf(d[coordinate.major]);
        coordinate.face = -1;
        if (!(depth > 0.0f && x <= 3.0e38f && y <= 3.0e38f && z <= 3.0e38f)) return coordinate;
        coordinate.forth = d[coordinate.major] < 0.0f ? -1.0f : 1.0f;
        coordinate.face = 2 * coordinate.major + (coordinate.forth < 0.0f);
        coordinate.across = coordinate.major == 0 ? 2 : 0, coordinate.up = coordinate.major == 1 ? 2 : 1;
        coordinate.right = coordinate.major == 0 ? -coordinate.forth : coordinate.major == 1 ? 1.0f : coordinate.forth;
        coordinate.upwards = coordinate.major == 1 ? coordinate.forth : -1.0f;
        coordinate.inverse = 1.0f / depth;
        coordinate.ratio_s = coordinate.right * d[coordinate.across] / depth,
        coordinate.ratio_t = coordinate.upwards * d[coordinate.up] / depth;
        coordinate.s = 0.5f * (coordinate.ratio_s + 1.0f), coordinate.t = 0.5f * (coordinate.ratio_t + 1.0f);
        return coordinate;
    }
};

NR_FUNC TextureCoordinate coordinate_of(const TextureLevels& texture, const Lookups& at, int64 pixel) {
    return texture.boundary == CUBE ? TextureCoordinate::of_direction(at.uv + pixel * 3)
                                    : TextureCoordinate::of_image(at.uv + pixel * 2);
}

// The offset of a texel of a level of a cube map. One step beyond a face it is the texel of the adjacent face, at the
// same distance from their edge; -1 beyond a corner, where there is none.
NR_FUNC int64 cube_texel(const TextureCoordinate& coordinate, int i, int j, int size) {
    const bool outside_s = i < 0 || i >= size, outside_t = j < 0 || j >= size;
    if (outside_s && outside_t) return -1;
    if (!outside_s && !outside_t) return ((int64)coordinate.face * size + j) * size + i;
    const float step = 1.0f / (float)size, last = (float)size - 0.5f;
    float direction[3];
    const float s = (float)(2 * i + 1 - size) * step, t = (float)(2 * j + 1 - size) * step;
    direction[coordinate.major] = coordinate.forth * (1.0f - step);
    direction[coordinate.across] = coordinate.right * clamp(s, -1.0f, 1.0f);
    direction[coordinate.up] = coordinate.upwards * clamp(t, -1.0f, 1.0f);
    const TextureCoordinate other = TextureCoordinate::of_direction(direction);
    const int column = (int)clamp(other.s * (float)size, 0.5f, last);
    const int row = (int)clamp(other.t * (float)size, 0.5f, last);
    return ((int64)other.face * size + row) * size + column;
}

// The four texels of a level around a sample, first along s, and their weights.
struct LevelBlock {
    int64 texel[4];  // offsets; -1 for a texel of zero
    float weight[4];
    float x, y;              // weights of the second texel along s and along t
    float slope_s, slope_t;  // derivative of the position in texels by s and t
    int missing;             // the texel beyond a corner of a cube, the mean of the three others; -1 for none
    float share;             // weight of the level in the sample

    NR_FUNC void weigh() {
        weight[0] = (1.0f - x) * (1.0f - y), weight[1] = x * (1.0f - y), weight[2] = (1.0f - x) * y, weight[3] = x * y;
    }
};

// The texels around a sample on a face of a cube. At a corner of the cube three texels share the weight of the fourth.
NR_FUNC void take_cube_texels(
    LevelBlock& block, const TextureCoordinate& coordinate, int i, int j, int size, int64 before) {
    for (int k = 0; k < 4; ++k) {
        const int64 texel = cube_texel(coordinate, i + (k & 1), j + (k >> 1), size);
        if (texel < 0) block.missing = k;
        block.texel[k] = texel < 0 ? -1 : before + texel;
    }
    if (block.missing < 0) return;
    const float third = block.weight[block.missing] * (1.0f / 3.0f);
    for (int k = 0; k < 4; ++k) block.weight[k] = k == block.missing ? 0.0f : block.weight[k] + third;
}

NR_FUNC LevelBlock block_at(const TextureLevels& texture, const TextureCoordinate& coordinate, int level, float share) {
    int width = texture.width, height = texture.height;
    int64 before = 0;
    for (int k = 0; k < level; ++k) {
        before += (int64)width * height * texture.sides();
        width = width > 1 ? width >> 1 : 1, height = height > 1 ? height >> 1 : 1;
    }
    const bool nearest = texture.filter == FILTER_NEAREST;
    const TexelPair<float> s(coordinate.s, width, texture.boundary, nearest),
        t(coordinate.t, height, texture.boundary_t, nearest);
    LevelBlock block;
    block.x = s.part[1], block.y = t.part[1], block.slope_s = s.slope, block.slope_t = t.slope;
    block.missing = -1, block.share = share;
    block.weigh();
    if (texture.boundary == CUBE) {
        take_cube_texels(block, coordinate, s.texel[0], t.texel[0], width, before);
        return block;
    }
    for (int k = 0; k < 4; ++k) {
        const int i = s.texel[k & 1], j = t.texel[k >> 1];
        const bool inside = i >= 0 && i < width && j >= 0 && j < height;
        block.texel[k] = inside ? before + (int64)j * width + i : -1;
    }
    return block;
}

// The level of a sample: log2 of the longer axis, in texels, of the ellipse to which a pixel maps in the texture, which
// is the larger singular value of the Jacobian of (s, t), plus the bias (Heckbert, "Fundamentals of texture mapping and
// image warping", 1989).
struct LevelChoice {
    int low;           // finer level
    float part;        // weight of the next, coarser level
    bool steady;       // whether the level is clamped or rounded down, so that its derivative is 0
    float change[4];   // of s and of t, right and up in turn, in texels
    float ss, tt, st;  // sums of products of changes
    float longer;      // square of the longer axis
};

NR_FUNC LevelChoice
choose_level(const TextureLevels& texture, const Lookups& at, const TextureCoordinate& coordinate, int64 pixel) {
    LevelChoice choice = {};
    choice.steady = true;
    if (texture.levels == 1) return choice;
    float level = 0.0f;
    if (at.footprint) {
        const float* d = at.footprint + pixel * (texture.boundary == CUBE ? 6 : 4);
        const float size[2] = {(float)texture.width, (float)texture.height};
        for (int n = 0; n < 2; ++n)        // right and up
            for (int c = 0; c < 2; ++c) {  // s and t
                float by = d[2 * c + n];
                if (texture.boundary == CUBE) {
                    const float numerator = (c ? coordinate.upwards : coordinate.right)
                        * d[2 * (c ? coordinate.up : coordinate.across) + n];
                    const float deeper = coordinate.forth * d[2 * coordinate.major + n];
                    const float ratio = c ? coordinate.ratio_t : coordinate.ratio_s;
                    by = 0.5f * (numerator - ratio * deeper) * coordinate.inverse;
                }
                choice.change[2 * c + n] = by * size[c];
            }
        const float* e = choice.change;
        choice.ss = e[0] * e[0] + e[1] * e[1], choice.tt = e[2] * e[2] + e[3] * e[3];
        choice.st = e[0] * e[2] + e[1] * e[3];
        const float half = 0.5f * (choice.ss - choice.tt);
        choice.longer = 0.5f * (choice.ss + choice.tt) + sqrtf(half * half + choice.st * choice.st);
        level = 0.5f * log2f(choice.longer);
    }
    if (at.bias) level += at.bias[pixel];
    const float last = (float)(texture.levels - 1);
    choice.steady = !(level > 0.0f && level < last);
    level = clamp(level, 0.0f, last);
    if (texture.filter == FILTER_NEAREST_LEVEL) level = floorf(level), choice.steady = true;
    choice.low = min((int)level, texture.levels - 1);
    choice.part = level - (float)choice.low;
    return choice;
}

// Call visit(image, pixel) for the pixels of a task.
template <class Visit>
NR_FUNC void for_each_lookup(const Lookups& at, int task, Visit visit) {
    const Pixels pixels = pixels_of_task(task, at.each, at.images * at.height, at.width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) visit(row / at.height, (int64)row * at.width + i);
}

struct SampleLevels {
    TextureLevels texture;
    Lookups at;
    float* result;  // [images, height, width, channels]
};

// Add the colours of a level; ``channels`` is an argument, so that it may be a constant for the compiler.
NR_FUNC void add_block(const LevelBlock& block, const float* texels, int channels, float* __restrict__ color) {
    float weight[4];
    const float* __restrict__ from[4];
    for (int k = 0; k < 4; ++k) {
        weight[k] = block.texel[k] < 0 ? 0.0f : block.share * block.weight[k];
        from[k] = texels + (block.texel[k] < 0 ? 0 : block.texel[k]) * channels;
    }
    for (int c = 0; c < channels; ++c)
        color[c] += weight[0] * from[0][c] + weight[1] * from[1][c] + weight[2] * from[2][c] + weight[3] * from[3][c];
}

// The pixels of a task. A direction of length 0 gives 0.
NR_FUNC void sample_levels(const SampleLevels& call, int task) {
    const TextureLevels& texture = call.texture;
    const int channels = texture.channels;
    for_each_lookup(call.at, task, [&](int image, int64 pixel) {
        float* color = call.result + pixel * channels;
        for (int c = 0; c < channels; ++c) color[c] = 0.0f;
        const TextureCoordinate coordinate = coordinate_of(texture, call.at, pixel);
        if (coordinate.face < 0) return;
        const LevelChoice choice = choose_level(texture, call.at, coordinate, pixel);
        const float* texels = texture.texels + texture.start(image);
        for (int n = 0; n < (choice.part > 0.0f ? 2 : 1); ++n) {
            const LevelBlock block =
                block_at(texture, coordinate, choice.low + n, n ? choice.part : 1.0f - choice.part);
            if (channels == 3) add_block(block, texels, 3, color);
            else add_block(block, texels, channels, color);
        }
    });
}

struct SampleLevelsBackward {
    TextureLevels texture;
    Lookups at;
    const float* grad;    // [images, height, width, channels]
    int texels_too;       // whether the gradient to texels is needed
    float* to_texels;     // [owners, total, channels], 0 before
    float* to_uv;         // as ``uv``
    float* to_footprint;  // as ``footprint``; null if it is
    float* to_bias;       // as ``bias``; null if it is
};

// Propagate the gradient of s and t on a face of a cube to the direction.
NR_FUNC void give_to_direction(const TextureCoordinate& coordinate, float to_s, float to_t, float* to_direction) {
    const float s = 0.5f * to_s * coordinate.inverse, t = 0.5f * to_t * coordinate.inverse;
    to_direction[coordinate.across] += coordinate.right * s, to_direction[coordinate.up] += coordinate.upwards * t;
    to_direction[coordinate.major] -= coordinate.forth * (s * coordinate.ratio_s + t * coordinate.ratio_t);
}

// Propagate the gradient of the level to the footprint and, for a cube map, to the direction.
NR_FUNC void level_backward(
    const SampleLevelsBackward& call, const TextureCoordinate& coordinate, const LevelChoice& choice, int64 pixel,
    float to_level) {
    if (call.to_bias) call.to_bias[pixel] = to_level;
    if (!call.to_footprint || !(choice.longer > 0.0f)) return;
    const float half = 0.5f * (choice.ss - choice.tt), root = choice.longer - 0.5f * (choice.ss + choice.tt);
    const float tilt = root > 0.0f ? 0.5f * half / root : 0.0f, cross = root > 0.0f ? choice.st / root : 0.0f;
    const float scale = to_level * 0.72134752f / choice.longer;  // 1 / (2 ln 2)
    const float *e = choice.change, size[2] = {(float)call.texture.width, (float)call.texture.height};
    const bool cube = call.texture.boundary == CUBE;
    float* to = call.to_footprint + pixel * (cube ? 6 : 4);
    for (int n = 0; n < 2; ++n)
        for (int c = 0; c < 2; ++c) {
            const float direct = (c ? 1.0f - 2.0f * tilt : 1.0f + 2.0f * tilt) * e[2 * c + n];
            const float to_change = scale * (direct + cross * e[2 * (1 - c) + n]) * size[c];
            if (!cube) {
                to[2 * c + n] += to_change;
                continue;
            }
            const int axis = c ? coordinate.up : coordinate.across;
            const float sign = c ? coordinate.upwards : coordinate.right,
                        ratio = c ? coordinate.ratio_t : coordinate.ratio_s;
            const float part = 0.5f * to_change * coordinate.inverse;
            to[2 * axis + n] += sign * part, to[2 * coordinate.major + n] -= coordinate.forth * ratio * part;
            // The change of s is (numerator - ratio deeper) / (2 depth), whose ratio and depth belong to the direction.
            const float deeper = coordinate.forth * call.at.footprint[pixel * 6 + 2 * coordinate.major + n];
            const float by = e[2 * c + n] / size[c];
            float* to_uv = call.to_uv + pixel * 3;
            to_uv[axis] -= sign * part * deeper * coordinate.inverse;
            to_uv[coordinate.major] += coordinate.forth * coordinate.inverse * (part * ratio * deeper - to_change * by);
        }
}

// Propagate the gradient of a level to its texels, unless ``to`` is null, and to their weights.
NR_FUNC void add_block_backward(
    const LevelBlock& block, const float* texels, int channels, const float* cotangent, float* to, float* gain) {
    for (int k = 0; k < 4; ++k) {
        if (block.texel[k] < 0) continue;
        const int64 at = block.texel[k] * channels;
        const float weight = block.share * block.weight[k];
        for (int c = 0; c < channels; ++c) {
            gain[k] += cotangent[c] * texels[at + c];
            if (to) add_product(to + at + c, weight, cotangent[c]);
        }
    }
}

// The pixels of a task. On the CPU one task has all pixels that share texels.
NR_FUNC void sample_levels_backward(const SampleLevelsBackward& call, int task) {
    const TextureLevels& texture = call.texture;
    const int channels = texture.channels;
    const int components = texture.boundary == CUBE ? 3 : 2;
    for_each_lookup(call.at, task, [&](int image, int64 pixel) {
        for (int c = 0; c < components; ++c) call.to_uv[pixel * components + c] = 0.0f;
        for (int c = 0; call.to_footprint && c < 2 * components; ++c)
            call.to_footprint[pixel * 2 * components + c] = 0.0f;
        if (call.to_bias) call.to_bias[pixel] = 0.0f;
        const TextureCoordinate coordinate = coordinate_of(texture, call.at, pixel);
        if (coordinate.face < 0) return;
        const LevelChoice choice = choose_level(texture, call.at, coordinate, pixel);
        const int64 start = texture.start(image);
        const float *texels = texture.texels + start, *cotangent = call.grad + pixel * channels;
        float to_s = 0.0f, to_t = 0.0f, to_level = 0.0f;
        for (int n = 0; n < (choice.part > 0.0f || !choice.steady ? 2 : 1); ++n) {
            const float share = n ? choice.part : 1.0f - choice.part;
            LevelBlock block = block_at(texture, coordinate, choice.low + n, share);
            float gain[4] = {};  // gradient with respect to each texel's weight
            float* to = call.texels_too ? call.to_texels + start : nullptr;
            if (channels == 3) add_block_backward(block, texels, 3, cotangent, to, gain);
            else add_block_backward(block, texels, channels, cotangent, to, gain);
            if (block.missing >= 0) gain[block.missing] = (gain[0] + gain[1] + gain[2] + gain[3]) * (1.0f / 3.0f);
            block.weigh();
            for (int k = 0; k < 4; ++k) to_level += (n ? gain[k] : -gain[k]) * block.weight[k];
            if (texture.filter == FILTER_NEAREST) continue;
            to_s += share * block.slope_s * ((1.0f - block.y) * (gain[1] - gain[0]) + block.y * (gain[3] - gain[2]));
            to_t += share * block.slope_t * ((1.0f - block.x) * (gain[2] - gain[0]) + block.x * (gain[3] - gain[1]));
        }
        if (!choice.steady) level_backward(call, coordinate, choice, pixel, to_level);
        if (texture.boundary == CUBE) give_to_direction(coordinate, to_s, to_t, call.to_uv + pixel * 3);
        else call.to_uv[pixel * 2] = to_s, call.to_uv[pixel * 2 + 1] = to_t;
    });
}

// Averages of blocks of 2 x 2 texels, or of 2 x 1 where a side is 1, become the next level; up to three of them.
struct HalveLevels {
    const float* images;  // the largest level, [owners, sides, height, width, channels]; null for another one
    float* texels;        // as of `TextureLevels`; this level, where it is the largest one, and the next are written
    int64 total;
    int64 before;  // texels of the levels before this one
    int owners;
    int sides;          // 6 for a cube map, else 1
    int height, width;  // texels of this level
    int channels;

    NR_FUNC int rows(int level) const { return max(height >> level, 1); }
    NR_FUNC int columns(int level) const { return max(width >> level, 1); }
    NR_FUNC int64 area(int level) const { return (int64)rows(level) * columns(level); }
};

// Channel c of texel (i, j), ``level`` levels after that of the texels ``from``.
template <int LEVEL>
NR_FUNC float average(const HalveLevels& call, const float* from, int i, int j, int c) {
    const int down = call.rows(LEVEL - 1) > 1 ? 2 : 1, across = call.columns(LEVEL - 1) > 1 ? 2 : 1;
    float sum = 0.0f;
    for (int n = 0; n < down * across; ++n)
        sum += average<LEVEL - 1>(call, from, i * across + n % across, j * down + n / across, c);
    return sum / (float)(down * across);
}
template <>
NR_FUNC float average<0>(const HalveLevels& call, const float* from, int i, int j, int c) {
    return from[((int64)j * call.width + i) * call.channels + c];
}

// One texel of one of the next levels.
NR_FUNC void halve_levels(const HalveLevels& call, int task) {
    const int images = call.owners * call.sides;
    int64 texel = task, before = call.before + call.sides * call.area(0);
    int level = 1;
    for (; texel >= images * call.area(level); ++level)
        texel -= images * call.area(level), before += call.sides * call.area(level);
    const int rows = call.rows(level), columns = call.columns(level), channels = call.channels;
    const int i = (int)(texel % columns), j = (int)(texel / columns % rows), image = (int)(texel / columns / rows);
    const int owner = image / call.sides, side = image % call.sides;
    float* start = call.texels + owner * call.total * channels;
    float* largest = start + (call.before + side * call.area(0)) * channels;
    const float* from = call.images ? call.images + image * call.area(0) * channels : largest;
    float* to = start + (before + ((int64)side * rows + j) * columns + i) * channels;
    for (int c = 0; c < channels; ++c)
        to[c] = level == 1 ? average<1>(call, from, i, j, c)
            : level == 2   ? average<2>(call, from, i, j, c)
                           : average<3>(call, from, i, j, c);
    if (level > 1 || !call.images) return;
    const int down = call.height > 1 ? 2 : 1, across = call.width > 1 ? 2 : 1;
    for (int row = j * down; row < (j + 1) * down; ++row)
        for (int64 at = ((int64)row * call.width + i * across) * channels, n = 0; n < across * channels; ++n)
            largest[at + n] = from[at + n];
}

struct HalveLevelsBackward {
    const float* grad;  // of the texels of all levels, [owners, total, channels]
    int64 total;
    int owners, sides;
    int height, width;   // texels of the largest level
    int level, smaller;  // the level whose gradient is computed, and the one that it begins with
    int channels;
    const float* known;  // gradient to the smaller level, as ``to_level``; null if it is the smallest one
    int each;            // rows of a task
    float* to_level;     // [owners, sides, rows, columns of the level, channels]

    NR_FUNC int rows(int of) const { return max(height >> of, 1); }
    NR_FUNC int columns(int of) const { return max(width >> of, 1); }
    // Texels of one side of the levels before another one.
    NR_FUNC int64 before(int of) const {
        int64 sum = 0;
        for (int k = 0; k < of; ++k) sum += (int64)rows(k) * columns(k);
        return sum;
    }
};

// The texels of a task. Each texel of a smaller level adds its gradient to the larger texels that it averages.
NR_FUNC void halve_levels_backward(const HalveLevelsBackward& call, int task) {
    const int rows = call.rows(call.level), columns = call.columns(call.level), channels = call.channels;
    const Pixels texels = pixels_of_task(task, call.each, call.owners * call.sides * rows, columns);
    for (int row = texels.first; row < texels.last; ++row) {
        const int j = row % rows, image = row / rows, side = image % call.sides;
        const float* grad = call.grad + image / call.sides * call.total * channels;
        float* to = call.to_level + (int64)row * columns * channels;
        int64 before = call.before(call.smaller);
        for (int level = call.smaller; level >= call.level; --level) {
            const int by = level - call.level, width = call.columns(level);
            const bool known = call.known && level == call.smaller;
            const float* from = known ? call.known : grad + before * call.sides * channels;
            from += ((int64)(known ? image : side) * call.rows(level) + (j >> by)) * width * channels;
            if (level > 0) before -= (int64)call.rows(level - 1) * call.columns(level - 1);
            const float share = level == call.smaller
                ? 0.0f
                : (call.rows(level) > 1 ? 0.5f : 1.0f) * (call.columns(level) > 1 ? 0.5f : 1.0f);
            for (int i = texels.left; i < texels.right; ++i)
                for (int c = 0; c < channels; ++c) {
                    const float value = from[(i >> by) * channels + c];
                    float& sum = to[(int64)i * channels + c];
                    sum = level == call.smaller ? value : sum * share + value;
                }
        }
    }
}

}  // namespace nr
