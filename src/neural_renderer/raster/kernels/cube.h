// The colour of a face at a point, blended from the 8 texels around it in a cube or from the colours of the corners;
// and the gradients of the blend.
#pragma once

#include "geometry.h"
#include "lanes.h"

namespace nr {

// The cubes of all faces, or the colours of their corners, and the light on them.
struct LitCubes {
    const vec3* texels;  // [cubes, faces, size, size, size], or of corners [cubes, faces, 3]
    const int* firsts;   // for images with different numbers of cubes: index of the first cube of each, and the total,
                         // [cubes + 1]; else null
    const vec3* light;   // factors on the front and the back of each face, [lamps, 2, faces]
    int cubes, lamps;    // images of cubes and of light; 1 if all share them
    int size;            // texels along a side of a cube; 0 for colours of corners
    float eps;           // coordinates in a cube end at size - 1 - eps

    NR_FUNC int64 volume() const { return size == 0 ? 3 : (int64)size * size * size; }
    // Whether a cube has so few texels that eight pixels are blended together.
    NR_FUNC bool is_small() const { return size <= 2; }
    // The offset of the first texel of a cube.
    NR_FUNC int64 place(const Scene& scene, int image, int face) const {
        const int64 first = firsts ? firsts[image] : (int64)broadcast(image, cubes) * scene.count;
        return (first + face) * volume();
    }
    NR_FUNC const vec3* cube(const Scene& scene, int image, int face) const {
        return texels + place(scene, image, face);
    }
    // Whether a face has a cube: padding has none.
    NR_FUNC bool has(int image, int face) const { return !firsts || face < firsts[image + 1] - firsts[image]; }
    NR_FUNC const vec3& light_on(const Scene& scene, int image, int face, int side) const {
        return light_on(scene, image, face, side, light, 0);
    }
    // The tangent of the light in a direction, from [directions, lamps, 2, faces].
    NR_FUNC const vec3& light_on(
        const Scene& scene, int image, int face, int side, const vec3* changes, int direction) const {
        return changes[(2 * ((int64)direction * lamps + broadcast(image, lamps)) + side) * scene.count + face];
    }
};

// Coordinates in a cube, one for each corner of a face: size - 1 times the corner's weight.
template <class F>
struct CubeCoordinates {
    typedef typename Lanes<F>::Mask Mask;
    F at[3];       // coordinates in texels, in [0, size - 1 - eps]
    Mask free[3];  // whether the coordinate was not clamped

    NR_FUNC CubeCoordinates(const F* weights, int size, float eps) {
        const float top = (float)(size - 1);
        const F most = all<F>(top - eps);
        for (int k = 0; k < 3; ++k) {
            const F raw = top * weights[k];
            at[k] = select(raw < most, raw, most);
            at[k] = select(at[k] > 0.0f, at[k], all<F>(0.0f));
            free[k] = raw == at[k];
        }
    }
};

// The texels around points in a cube: the first of two along each axis, and the weights of the second ones.
template <class F>
struct CubePoints {
    typedef typename Lanes<F>::Ints Ints;
    Ints first;  // the first texel along all axes
    F up[3];
    typename Lanes<F>::Mask free[3];

    NR_FUNC CubePoints(const CubeCoordinates<F>& inside, int size) : first{} {
        for (int k = 0; k < 3; ++k) {
            const Ints down = to_ints(inside.at[k]);  // the last texel has no successor
            const Ints low = size == 1 ? down : select(down < size - 1, down, Ints{} + (size - 2));
            first = first * size + low, up[k] = inside.at[k] - to_floats(low), free[k] = inside.free[k];
        }
    }
};

// The point of one pixel in a cube of any size, or between corners (size 0). A cube of one texel needs no blending.
struct Cube {
    int size, first;  // see `CubePoints`
    float up[3];      // weights of the second texels, or of corners
    bool free[3];

    NR_FUNC Cube(const float* weights, int texels, float eps) : size(texels), first(0) {
        if (size > 0) set(CubePoints<float>({weights, size, eps}, size), 0);
        for (int k = 0; k < 3 && size == 0; ++k) up[k] = weights[k], free[k] = true;
    }
    // The point of one of several pixels.
    template <class F>
    NR_FUNC Cube(const CubePoints<F>& points, int pixel, int texels) : size(texels) {
        set(points, pixel);
    }
    template <class F>
    NR_FUNC void set(const CubePoints<F>& points, int n) {
        first = lane_in_memory(points.first, n);
        for (int k = 0; k < 3; ++k)
            up[k] = lane_in_memory(points.up[k], n), free[k] = lane_in_memory(points.free[k], n) != 0;
    }
    NR_FUNC float part(int axis, int above) const { return above ? up[axis] : 1.0f - up[axis]; }
    NR_FUNC int texel(int i, int j, int k) const { return first + (i * size + j) * size + k; }
    NR_FUNC vec3 blend(const vec3* texels) const {
        if (size == 1) return texels[0];
        if (size == 0) {
            vec3 color;
            for (int c = 0; c < 3; ++c) color[c] = interpolated(up, texels[0].c, c, 3);
            return color;
        }
#if NR_LANES
        floats4 sum = {};
        for (int n = 0; n < 8; ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            sum += part(0, i) * part(1, j) * part(2, k) * as_vector(texels[texel(i, j, k)]);
        }
        return as_vec3(sum);
#else
        vec3 sum = {};
        for (int n = 0; n < 8; ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            sum += part(0, i) * part(1, j) * part(2, k) * texels[texel(i, j, k)];
        }
        return sum;
#endif
    }
    // Add the gradient of a colour to the texels. If ``exclusive``, no other task writes them.
    NR_FUNC void scatter(vec3* texels, const vec3& color, bool exclusive) const {
        if (size == 1) return add(texels, color, exclusive);
        for (int k = 0; k < 3 && size == 0; ++k) add(texels + k, up[k] * color, exclusive);
        for (int n = 0; n < (size == 0 ? 0 : 8); ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            add(texels + texel(i, j, k), part(0, i) * part(1, j) * part(2, k) * color, exclusive);
        }
    }
#if NR_LANES
    // The blend of a cube of several texels, and its derivatives by the weights of the corners, times ``color``.
    void blend_and_slope(const vec3* texels, const vec3& color, vec3& blended, vec3& slope) const {
        NR_FUSED
        floats4 along[2], by_last[2], by_middle[2];  // blends along the last two axes, and their slopes
        for (int i = 0; i < 2; ++i) {
            floats4 row[2], rise[2];
            for (int j = 0; j < 2; ++j) {
                const vec3* at = texels + texel(i, j, 0);
                rise[j] = as_vector(at[1]) - as_vector(at[0]);
                row[j] = as_vector(at[0]) + up[2] * rise[j];
            }
            by_middle[i] = row[1] - row[0];
            along[i] = row[0] + up[1] * by_middle[i];
            by_last[i] = rise[0] + up[1] * (rise[1] - rise[0]);
        }
        const floats4 by_first = along[1] - along[0];
        blended = as_vec3(along[0] + up[0] * by_first);
        const floats4 by[3] = {
            by_first, by_middle[0] + up[0] * (by_middle[1] - by_middle[0]),
            by_last[0] + up[0] * (by_last[1] - by_last[0])};
        for (int k = 0; k < 3; ++k) slope[k] = free[k] ? dot(as_vec3(by[k]), color) * (float)(size - 1) : 0.0f;
    }
#endif
    // The derivative of the blend, times ``color``, by the weights of the corners.
    NR_FUNC vec3 slope(const vec3* texels, const vec3& color) const {
        if (size == 0) return {dot(texels[0], color), dot(texels[1], color), dot(texels[2], color)};
        vec3 sum = {};
        for (int n = 0; n < (size == 1 ? 0 : 8); ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            const float gain = dot(texels[texel(i, j, k)], color);
            sum[0] += (i ? gain : -gain) * part(1, j) * part(2, k);
            sum[1] += (j ? gain : -gain) * part(0, i) * part(2, k);
            sum[2] += (k ? gain : -gain) * part(0, i) * part(1, j);
        }
        for (int k = 0; k < 3; ++k) sum[k] = free[k] ? sum[k] * (float)(size - 1) : 0.0f;
        return sum;
    }
};

#if NR_LANES
// The points of eight pixels of one face, between its corners, or in a cube of one texel or of 2 x 2 x 2. All pixels
// use the same texels, so that blending axis by axis takes fewer products than `Cube` and no lookups.
struct CubeOfEight {
    // Sums of gradients over pixels, times the weights of texels.
    struct Sums {
        floats8 of_texel[8][3] = {};

        vec3 of(int n) const { return {sum(of_texel[n][0]), sum(of_texel[n][1]), sum(of_texel[n][2])}; }
    };
    int size;
    const floats8* weights;
    CubeCoordinates<floats8> inside;
    const floats8* up = inside.at;  // weights of the second texels; ``down``: of the first ones
    floats8 down[3];

    CubeOfEight(const floats8* of_corners, int texels, float eps)
        : size(texels), weights(of_corners), inside(of_corners, texels, eps) {
        for (int k = 0; k < 3; ++k) down[k] = 1.0f - up[k];
    }
    CubeOfEight(const CubeOfEight&) = delete;
    void blend(const vec3* texels, floats8* color) const {
        if (size != 0) return blend_texels(texels, color);
        for (int c = 0; c < 3; ++c) color[c] = interpolated(weights, texels[0].c, c, 3);
    }
    void blend_texels(const vec3* texels, floats8* color) const {
        NR_FUSED
        for (int c = 0; c < 3; ++c) {
            color[c] = all<floats8>(texels[0][c]);
            if (size == 1) continue;
            floats8 far[4];
            for (int n = 0; n < 4; ++n) far[n] = down[2] * texels[2 * n][c] + up[2] * texels[2 * n + 1][c];
            color[c] = down[0] * (down[1] * far[0] + up[1] * far[1]) + up[0] * (down[1] * far[2] + up[1] * far[3]);
        }
    }
    void scatter(Sums& sums, const floats8* color) const {
        NR_FUSED
        if (size == 1) {
            for (int c = 0; c < 3; ++c) sums.of_texel[0][c] += color[c];
            return;
        }
        if (size == 0) {
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 3; ++c) sums.of_texel[k][c] += weights[k] * color[c];
            return;
        }
        for (int n = 0; n < 8; ++n) {
            const floats8 part =
                ((n >> 2) ? up[0] : down[0]) * (((n >> 1) & 1) ? up[1] : down[1]) * ((n & 1) ? up[2] : down[2]);
            for (int c = 0; c < 3; ++c) sums.of_texel[n][c] += part * color[c];
        }
    }
    // The derivative of the blend, times ``color``, by the weights of the corners.
    void slope(const vec3* texels, const floats8* color, floats8* to_weights) const {
        NR_FUSED
        for (int k = 0; k < 3; ++k) to_weights[k] = floats8{};
        if (size == 1) return;
        floats8 gain[8];
        for (int n = 0; n < (size == 0 ? 3 : 8); ++n)
            gain[n] = texels[n][0] * color[0] + texels[n][1] * color[1] + texels[n][2] * color[2];
        for (int k = 0; k < 3 && size == 0; ++k) to_weights[k] = gain[k];
        if (size == 0) return;
        for (int n = 0; n < 4; ++n) {
            const int j = n >> 1, k = n & 1;
            const floats8 *a = j ? up : down, *b = k ? up : down;
            to_weights[0] += a[1] * b[2] * (gain[4 + n] - gain[n]);
            to_weights[1] += a[0] * b[2] * (gain[4 * j + 2 + k] - gain[4 * j + k]);
            to_weights[2] += a[0] * b[1] * (gain[4 * j + 2 * k + 1] - gain[4 * j + 2 * k]);
        }
        for (int k = 0; k < 3; ++k) to_weights[k] = select(inside.free[k], to_weights[k], floats8{});
    }
};
#endif

}  // namespace nr
