// Analytic anti-aliasing of silhouettes in a drawn image, and its gradient to vertices (Laine et al., "Modular
// primitives for high-performance differentiable rendering", 2020, on antialiasing).
//
// An edge is a silhouette where one triangle ends, or where the surface folds behind itself. Two adjacent pixels show
// different triangles, and the nearer one ends at a silhouette at distance d from its pixel's centre towards the other
// centre, in pixels. Then the pixel that the silhouette crosses, the nearer one's if d < 1/2, changes by
// (d - 1/2) (nearer colour - other colour). Steep edges blend horizontal neighbours, flat edges vertical ones.
#pragma once

#include "clip.h"

namespace nr {

// The determinant of the (x, y, w) of three vertices, positive if they run counter-clockwise on the screen. Products of
// two floats are exact in double.
NR_FUNC double orientation(const float* a, const float* b, const float* c) {
    const double ax = a[0], ay = a[1], aw = a[3], bx = b[0], by = b[1], bw = b[3];
    return ax * (by * c[3] - c[1] * bw) - ay * (bx * c[3] - c[0] * bw) + aw * (bx * c[1] - c[0] * by);
}

struct FindSilhouettes {
    ClipMesh mesh;
    const int* siblings;  // sibling half-edges, as from `find_half_edges`, [count, 3]
    int* silhouettes;     // bit k: the edge from corner k to the next is a silhouette, [images, count]
};

// One triangle in one image. The surface continues across an edge if any triangle there lies on its other side.
NR_FUNC void find_silhouettes(const FindSilhouettes& call, int task) {
    const ClipMesh& mesh = call.mesh;
    const int image = task / mesh.count, f = task % mesh.count;
    const float* positions = mesh.positions + mesh.start(image);
    const int* corner = mesh.corners(f);
    int bits = 0;
    for (int k = 0; corner && k < 3; ++k) {
        const float* start = positions + (int64)corner[k] * 4;
        const float* end = positions + (int64)corner[(k + 1) % 3] * 4;
        const double this_side = orientation(start, end, positions + (int64)corner[(k + 2) % 3] * 4);
        bool continues = false;
        for (int edge = call.siblings[3 * f + k]; edge != 3 * f + k && !continues; edge = call.siblings[edge]) {
            const int* other = mesh.corners(edge / 3);
            if (!other) continue;
            const double side = orientation(start, end, positions + (int64)other[(edge + 2) % 3] * 4);
            continues = this_side > 0.0 ? side < 0.0 : side > 0.0;
        }
        bits |= (this_side != 0.0 && !continues) << k;
    }
    call.silhouettes[task] = bits;
}

struct Silhouettes {
    ClipMesh mesh;
    const float* rast;       // as from `show_triangles`, [images, height, width, 4]
    const int* silhouettes;  // as from `find_silhouettes`
    int each;                // rows of a task
};

// The silhouette between two adjacent pixels, the second one to the right of the first or above it.
struct SilhouetteCrossing {
    float share;    // (d - 1/2), or (1/2 - d) where the second pixel is nearer; 0 for none
    int edge;       // number of the silhouette, 3 f + k
    int i, j;       // the nearer pixel's column, and row from the bottom
    bool upright;   // whether the pixels are vertical neighbours
    float towards;  // 1 if the other pixel lies to the right or above, else -1
};

// Rounding error of d for a pixel centre on the silhouette.
constexpr float ON_EDGE = 1.0e-3f;

// The ends of an edge relative to a pixel centre: along the line to the other centre, across it, and w.
struct EdgeAtPixel {
    float along[2], across[2], w[2];

    NR_FUNC EdgeAtPixel(const ClipMesh& mesh, int image, int edge, bool upright, float right, float up) {
        const float* positions = mesh.positions + mesh.start(image);
        const int* corner = mesh.triangles + (int64)(edge / 3) * 3;
        for (int n = 0; n < 2; ++n) {
            const float* at = positions + (int64)corner[(edge + n) % 3] * 4;
            const float x = at[0] - right * at[3], y = at[1] - up * at[3];
            along[n] = upright ? y : x, across[n] = upright ? x : y, w[n] = at[3];
        }
    }
    // The edge crosses the line at top / bottom, in screen units from the centre.
    NR_FUNC float top() const { return along[0] * across[1] - along[1] * across[0]; }
    NR_FUNC float bottom() const { return w[0] * across[1] - w[1] * across[0]; }
    // Whether the edge crosses the line, in front of the camera, at an angle of at least 45 degrees in the image.
    NR_FUNC bool crosses(float size_along, float size_across, bool upright) const {
        const bool apart = (across[0] < 0.0f) != (across[1] < 0.0f);
        if (!apart || !(bottom() * (across[1] - across[0]) > 0.0f)) return false;
        const float flat = fabsf(along[1] * w[0] - along[0] * w[1]) * size_along;
        const float steep = fabsf(across[1] * w[0] - across[0] * w[1]) * size_across;
        return upright ? steep > flat : steep >= flat;
    }
};

NR_FUNC SilhouetteCrossing silhouette_between(const Silhouettes& call, int image, int i, int j, bool upright) {
    const ClipMesh& mesh = call.mesh;
    const int64 first = ((int64)image * mesh.height + j) * mesh.width + i;
    SilhouetteCrossing found = {0.0f, 0, i, j, upright, 1.0f};
    const float *a = call.rast + first * 4, *b = a + (upright ? mesh.width : 1) * 4;
    if (a[3] == b[3]) return found;
    if (a[3] == 0.0f || (b[3] != 0.0f && b[2] < a[2])) {
        a = b;
        found.towards = -1.0f, found.i += !upright, found.j += upright;
    }
    const int f = shown_triangle(a, mesh.count);
    if (!mesh.corners(f)) return found;  // the backward pass reads indices again, which may have changed
    const int bits = call.silhouettes[(int64)image * mesh.count + f];
    if (bits == 0) return found;
    const float right = pixel_centre(found.i, mesh.width), up = pixel_centre(found.j, mesh.height);
    const float size = (float)(upright ? mesh.height : mesh.width), wide = (float)(upright ? mesh.width : mesh.height);
    for (int k = 0; k < 3; ++k) {
        if (!(bits >> k & 1)) continue;
        const EdgeAtPixel ends(mesh, image, 3 * f + k, upright, right, up);
        if (!ends.crosses(size, wide, upright)) continue;
        const float d = 0.5f * size * found.towards * ends.top() / ends.bottom();
        if (!(d >= -ON_EDGE && d <= 1.0f + ON_EDGE)) continue;
        found.share = found.towards * (d - 0.5f), found.edge = 3 * f + k;
        return found;
    }
    return found;
}

// Call visit(image, pixel, i, j) for the pixels of a task; rows j count from the bottom.
template <class Visit>
NR_FUNC void for_each_pixel(const Silhouettes& call, int task, Visit visit) {
    const int height = call.mesh.height, width = call.mesh.width;
    const Pixels pixels = pixels_of_task(task, call.each, call.mesh.images * height, width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) visit(row / height, (int64)row * width + i, i, row % height);
}

// The share by which a pixel blends with the one to the right, or with the one above.
NR_FUNC float share_of(const Silhouettes& call, int image, int i, int j, bool upright) {
    const bool inside = upright ? j + 1 < call.mesh.height : i + 1 < call.mesh.width;
    return inside ? silhouette_between(call, image, i, j, upright).share : 0.0f;
}

// Call visit(first, second, share) for each blended pair that contains a pixel. The second pixel changes if the share
// is positive, else the first one, by the share of their difference. ``share_at(pixel, i, j, n)`` is the share of a
// pixel with the one to the right, n = 0, or the one above, n = 1; 0 outside of the image.
template <class Share, class Visit>
NR_FUNC void for_each_share(int64 pixel, int i, int j, int width, Share share_at, Visit visit) {
    for (int n = 0; n < 2; ++n) {
        const int64 step = n ? width : 1;
        if (const float share = share_at(pixel, i, j, n)) visit(pixel, pixel + step, share);
    }
    for (int n = 0; n < 2; ++n) {
        const int64 before = pixel - (n ? width : 1);
        if (const float share = share_at(before, i - !n, j - n, n)) visit(before, pixel, share);
    }
}

struct BlendPixels {
    Silhouettes of;
    const float* colors;  // [images, height, width, channels]
    int channels;
    float* result;  // as the colours
    float* shares;  // of each pixel with the one to the right and the one above, [images, height, width, 2]
};

NR_FUNC void find_shares_of(const BlendPixels& call, int image, int64 pixel, int i, int j) {
    for (int n = 0; n < 2; ++n) call.shares[pixel * 2 + n] = share_of(call.of, image, i, j, n == 1);
}

template <class Share>
NR_FUNC void blend_pixel(const BlendPixels& call, int64 pixel, int i, int j, Share share_at) {
    const int channels = call.channels;
    const float* colors = call.colors;
    float* to = call.result + pixel * channels;
    for (int c = 0; c < channels; ++c) to[c] = colors[pixel * channels + c];
    for_each_share(pixel, i, j, call.of.mesh.width, share_at, [&](int64 first, int64 second, float share) {
        if ((share > 0.0f ? second : first) != pixel) return;
        for (int c = 0; c < channels; ++c)
            to[c] += share * (colors[first * channels + c] - colors[second * channels + c]);
    });
}

// The shares of the pixels of a task.
NR_FUNC void find_shares(const BlendPixels& call, int task) {
    for_each_pixel(
        call.of, task, [&](int image, int64 pixel, int i, int j) { find_shares_of(call, image, pixel, i, j); });
}

// The pixels of a task, by the shares.
NR_FUNC void blend_pixels(const BlendPixels& call, int task) {
    const float* shares = call.shares;
    for_each_pixel(call.of, task, [&](int, int64 pixel, int i, int j) {
        blend_pixel(call, pixel, i, j, [shares](int64 at, int column, int row, int n) {
            return column < 0 || row < 0 ? 0.0f : shares[at * 2 + n];
        });
    });
}

// Both in one launch, which finds each share twice.
NR_FUNC void find_and_blend(const BlendPixels& call, int task) {
    for_each_pixel(call.of, task, [&](int image, int64 pixel, int i, int j) {
        find_shares_of(call, image, pixel, i, j);
        blend_pixel(call, pixel, i, j, [&](int64 at, int column, int row, int n) {
            if (at == pixel) return call.shares[at * 2 + n];
            return column < 0 || row < 0 ? 0.0f : share_of(call.of, image, column, row, n == 1);
        });
    });
}

struct BlendPixelsBackward {
    Silhouettes of;
    const float* shares;  // as from `blend_pixels`
    const float* colors;  // [images, height, width, channels]
    int channels;
    const float* grad;    // of the result
    float boost;          // factor of the gradient to positions
    float* to_colors;     // as the colours; null if not needed
    float* to_positions;  // [owners, vertices, 4], 0 before; null if not needed
};

NR_FUNC void pixel_backward(const BlendPixelsBackward& call, int64 pixel, int i, int j) {
    const int channels = call.channels;
    float* to = call.to_colors + pixel * channels;
    for (int c = 0; c < channels; ++c) to[c] = call.grad[pixel * channels + c];
    const auto share_at = [&](int64 at, int column, int row, int n) {
        return column < 0 || row < 0 ? 0.0f : call.shares[at * 2 + n];
    };
    for_each_share(pixel, i, j, call.of.mesh.width, share_at, [&](int64 first, int64 second, float share) {
        const float* cotangent = call.grad + (share > 0.0f ? second : first) * channels;
        for (int c = 0; c < channels; ++c) to[c] += (pixel == first ? share : -share) * cotangent[c];
    });
}

// The gradient of a share to the two vertices of its edge.
NR_FUNC void share_backward(
    const BlendPixelsBackward& call, int image, const SilhouetteCrossing& found, float to_share) {
    if (found.share == 0.0f) return;
    const ClipMesh& mesh = call.of.mesh;
    const bool upright = found.upright;
    const float right = pixel_centre(found.i, mesh.width), up = pixel_centre(found.j, mesh.height);
    const EdgeAtPixel ends(mesh, image, found.edge, upright, right, up);
    const float part = 1.0f / ends.bottom(), at = ends.top() * part;
    const float to_top = 0.5f * (float)(upright ? mesh.height : mesh.width) * to_share * part;
    const float to_bottom = -to_top * at;
    const int* corner = mesh.triangles + (int64)(found.edge / 3) * 3;
    for (int n = 0; n < 2; ++n) {
        const float sign = n ? -1.0f : 1.0f;  // both terms change sign if the ends are exchanged
        const float to_along = sign * to_top * ends.across[1 - n];
        const float to_across = -sign * (to_top * ends.along[1 - n] + to_bottom * ends.w[1 - n]);
        const float to_x = upright ? to_across : to_along, to_y = upright ? to_along : to_across;
        const float to_w = sign * to_bottom * ends.across[1 - n] - right * to_x - up * to_y;
        float* to = call.to_positions + mesh.start(image) + (int64)corner[(found.edge + n) % 3] * 4;
        atomic_add(to, to_x), atomic_add(to + 1, to_y), atomic_add(to + 3, to_w);
    }
}

// The gradient of a pixel's shares with those to the right and above, to positions.
NR_FUNC void shares_backward(const BlendPixelsBackward& call, int image, int64 first, int i, int j) {
    const int channels = call.channels;
    for (int n = 0; n < 2; ++n) {
        const float share = call.shares[first * 2 + n];
        if (share == 0.0f) continue;
        const int64 second = first + (n ? call.of.mesh.width : 1);
        const float* cotangent = call.grad + (share > 0.0f ? second : first) * channels;
        float to_share = 0.0f;
        for (int c = 0; c < channels; ++c)
            to_share += cotangent[c] * (call.colors[first * channels + c] - call.colors[second * channels + c]);
        if (to_share == 0.0f) continue;
        share_backward(call, image, silhouette_between(call.of, image, i, j, n == 1), call.boost * to_share);
    }
}

// The pixels of a task. On the CPU, one task has all pixels that share vertices if the positions get a gradient.
NR_FUNC void blend_pixels_backward(const BlendPixelsBackward& call, int task) {
    for_each_pixel(call.of, task, [&](int image, int64 pixel, int i, int j) {
        if (call.to_colors) pixel_backward(call, pixel, i, j);
        if (call.to_positions) shares_backward(call, image, pixel, i, j);
    });
}

}  // namespace nr
