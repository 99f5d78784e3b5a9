"""A cube of texels in plain C++: the 8 texels around a point, blended, and the gradients of the blend.

Needs the structs of `raster/warp/point.py`.
"""

from ..warp.geometry import FACING

# The 8 texels around a coordinate in a cube, and their weights. A cube of one texel has nothing to blend.
CUBE = """
struct Cube {
    typedef wp::vec_t<3, float> vec3;
    int size, low[3];
    float up[3];
    bool free[3];  // the coordinate was not clamped

    CUDA_CALLABLE Cube(const vec3& weights, int texels, float eps) : size(texels) {
        for (int k = 0; k < 3; ++k) {
            const float top = (float)(size - 1), raw = top * weights[k], most = top - eps;
            float at = raw < most ? raw : most;
            at = at > 0.0f ? at : 0.0f;
            const int down = (int)at;  // the last texel has no other one after it
            low[k] = down < size - 1 || size == 1 ? down : size - 2;
            free[k] = raw == at, up[k] = at - (float)low[k];
        }
    }
    CUDA_CALLABLE float part(int axis, int above) const { return above ? up[axis] : 1.0f - up[axis]; }
    CUDA_CALLABLE int texel(int i, int j, int k) const {
        return ((low[0] + i) * size + low[1] + j) * size + low[2] + k;
    }
    CUDA_CALLABLE vec3 blend(const vec3* texels) const {
        if (size == 1) return texels[0];
        vec3 sum(0.0f);
        for (int n = 0; n < 8; ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            sum += part(0, i) * part(1, j) * part(2, k) * texels[texel(i, j, k)];
        }
        return sum;
    }
    CUDA_CALLABLE void scatter(vec3* texels, const vec3& color, bool alone) const {
        for (int n = 0; n < (size == 1 ? 1 : 8); ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            const vec3 add = size == 1 ? color : part(0, i) * part(1, j) * part(2, k) * color;
            vec3* to = texels + (size == 1 ? 0 : texel(i, j, k));
            if (alone) *to += add;
            else wp::atomic_add(to, add);
        }
    }
    // The derivative of the blend, times `color`, by the weights of the corners.
    CUDA_CALLABLE vec3 slope(const vec3* texels, const vec3& color) const {
        vec3 sum(0.0f);
        for (int n = 0; n < (size == 1 ? 0 : 8); ++n) {
            const int i = n >> 2, j = (n >> 1) & 1, k = n & 1;
            const float gain = wp::dot(texels[texel(i, j, k)], color);
            sum[0] += (i ? gain : -gain) * part(1, j) * part(2, k);
            sum[1] += (j ? gain : -gain) * part(0, i) * part(2, k);
            sum[2] += (k ? gain : -gain) * part(0, i) * part(1, j);
        }
        for (int k = 0; k < 3; ++k) sum[k] = free[k] ? sum[k] * (float)(size - 1) : 0.0f;
        return sum;
    }
};
#if !defined(__CUDA_ARCH__)
// The same for eight pixels of one face at once, in cubes of one texel or of 2 x 2 x 2.
struct CubeOfEight {
    typedef wp::vec_t<3, float> vec3;
    typedef Eight::floats floats;
    int size;
    floats up[3], down[3];
    Eight::ints free[3];

    CubeOfEight(const floats* weights, int texels, float eps) : size(texels) {
        const float top = (float)(size - 1);
        const floats most = Eight::none() + (top - eps);
        for (int k = 0; k < 3; ++k) {
            const floats raw = top * weights[k];
            floats at = raw < most ? raw : most;
            at = at > 0.0f ? at : Eight::none();
            free[k] = raw == at, up[k] = at, down[k] = 1.0f - at;
        }
    }
    void blend(const vec3* texels, floats* color) const {
        #pragma clang fp contract(fast)
        for (int c = 0; c < 3; ++c) {
            color[c] = Eight::none() + texels[0][c];
            if (size == 1) continue;
            floats far[4];
            for (int n = 0; n < 4; ++n) far[n] = down[2] * texels[2 * n][c] + up[2] * texels[2 * n + 1][c];
            color[c] = down[0] * (down[1] * far[0] + up[1] * far[1]) + up[0] * (down[1] * far[2] + up[1] * far[3]);
        }
    }
    // Sums of gradients over pixels, times the parts of texels.
    struct Sums {
        floats of_texel[8][3];
        Sums() {
            for (int n = 0; n < 8; ++n) for (int c = 0; c < 3; ++c) of_texel[n][c] = Eight::none();
        }
        vec3 of(int n) const {
            return vec3(Eight::sum(of_texel[n][0]), Eight::sum(of_texel[n][1]), Eight::sum(of_texel[n][2]));
        }
    };
    void scatter(Sums& sums, const floats* color) const {
        #pragma clang fp contract(fast)
        if (size == 1) {
            for (int c = 0; c < 3; ++c) sums.of_texel[0][c] += color[c];
            return;
        }
        for (int n = 0; n < 8; ++n) {
            const floats part = ((n >> 2) ? up[0] : down[0]) * (((n >> 1) & 1) ? up[1] : down[1])
                * ((n & 1) ? up[2] : down[2]);
            for (int c = 0; c < 3; ++c) sums.of_texel[n][c] += part * color[c];
        }
    }
    // The derivative of the blend, times `color`, by the weights of the corners.
    void slope(const vec3* texels, const floats* color, floats* to_weights) const {
        #pragma clang fp contract(fast)
        for (int k = 0; k < 3; ++k) to_weights[k] = Eight::none();
        if (size == 1) return;
        floats gain[8];
        for (int n = 0; n < 8; ++n)
            gain[n] = texels[n][0] * color[0] + texels[n][1] * color[1] + texels[n][2] * color[2];
        for (int n = 0; n < 4; ++n) {
            const int j = n >> 1, k = n & 1;
            to_weights[0] += (j ? up[1] : down[1]) * (k ? up[2] : down[2]) * (gain[4 + n] - gain[n]);
            to_weights[1] += (j ? up[0] : down[0]) * (k ? up[2] : down[2]) * (gain[4 * j + 2 + k] - gain[4 * j + k]);
            to_weights[2] += (j ? up[0] : down[0]) * (k ? up[1] : down[1])
                * (gain[4 * j + 2 * k + 1] - gain[4 * j + 2 * k]);
        }
        for (int k = 0; k < 3; ++k) to_weights[k] = free[k] ? to_weights[k] : Eight::none();
    }
};
#endif
struct Side {
    typedef wp::vec_t<3, float> vec3;
    static CUDA_CALLABLE int facing(vec3 v0, vec3 v1, vec3 v2, int perspective) { FACING }
    // 1 if the back of a face is visible, else 0.
    static CUDA_CALLABLE int of(const vec3* v, int perspective) { return facing(v[0], v[1], v[2], perspective) < 0; }
};
""".replace("FACING", FACING)
