// Voxels of a mesh: those that its surface intersects, those that it encloses, and distances from them.
#pragma once

#include "platform.h"

namespace nr {

constexpr byte EMPTY = 0, SURFACE = 1, OUTSIDE = 2;

// Grids of size^3 voxels. Voxel (i, j, k) is [i, i + 1] x [j, j + 1] x [k, k + 1].
struct Grids {
    byte* state;  // EMPTY, SURFACE or OUTSIDE, [batch, size, size, size]
    int size;     // voxels

    NR_FUNC byte& at(int b, int i, int j, int k) const { return state[(((int64)b * size + i) * size + j) * size + k]; }
    // The voxel at (p, q) across an axis and ``along`` it; coordinates rotate so that the axis is the last.
    NR_FUNC byte& across(int b, int axis, int p, int q, int along) const {
        return axis == 0 ? at(b, along, p, q) : axis == 1 ? at(b, q, along, p) : at(b, p, q, along);
    }
};

struct MarkSurface {
    Grids grids;           // EMPTY before
    const vec3* vertices;  // positions in voxels, [batch, vertex_count]
    int vertex_count;
    const int* faces;  // vertices of each face, [face_count, 3]
    int face_count;
    int groups;     // groups of faces, a task each
    float spacing;  // largest distance between points on a face, in voxels

    // Mark the voxel of a point, at (x, y) across ``axis`` and z along it, if it is in the grid.
    NR_FUNC void mark(int b, int axis, float x, float y, float z) const {
        const float size = (float)grids.size;
        // Tested before the conversion, which gives different integers for NaN on different devices.
        if (x >= 0.0f && x < size && y >= 0.0f && y < size && z >= 0.0f && z < size)
            grids.across(b, axis, (int)x, (int)y, (int)z) = SURFACE;
    }
};

// Mark the four voxels around each intersection of a face with the lines through integer coordinates along an axis.
NR_FUNC void mark_lines(const MarkSurface& call, int b, int axis, const vec3* face) {
    vec3 v[3];
    for (int n = 0; n < 3; ++n) v[n] = {face[n][(axis + 1) % 3], face[n][(axis + 2) % 3], face[n][axis]};
    const float size = (float)call.grids.size;
    int first[2], last[2];
    for (int k = 0; k < 2; ++k) {
        const float low = min(v[0][k], min(v[1][k], v[2][k]));
        const float high = max(v[0][k], max(v[1][k], v[2][k]));
        first[k] = (int)ceilf(clamp(low, 0.0f, size + 1.0f)), last[k] = (int)floorf(clamp(high, -1.0f, size));
    }
    for (int p = first[0]; p <= last[0]; ++p)
        for (int q = first[1]; q <= last[1]; ++q) {
            const float x = (float)p, y = (float)q;
            const float e0 = (v[1][0] - x) * (v[2][1] - y) - (v[1][1] - y) * (v[2][0] - x);
            const float e1 = (v[2][0] - x) * (v[0][1] - y) - (v[2][1] - y) * (v[0][0] - x);
            const float e2 = (v[0][0] - x) * (v[1][1] - y) - (v[0][1] - y) * (v[1][0] - x);
            const float area = e0 + e1 + e2;
            if (!(area != 0.0f && e0 * area >= 0.0f && e1 * area >= 0.0f && e2 * area >= 0.0f)) continue;
            const float along = (e0 * v[0][2] + e1 * v[1][2] + e2 * v[2][2]) / area;
            for (int i = 0; i < 4; ++i) call.mark(b, axis, (float)(p - i % 2), (float)(q - i / 2), along);
        }
}

// Mark the voxels of a face's corners, and of points between them.
NR_FUNC void mark_points(const MarkSurface& call, int b, const vec3* v) {
    float longest = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const vec3 side = v[(k + 1) % 3] - v[k];
        longest = max(longest, sqrtf(dot(side, side)));
    }
    const int steps = (int)clamp(ceilf(longest / call.spacing), 1.0f, 1024.0f);
    for (int i = 0; i <= steps; ++i)
        for (int j = 0; j <= steps - i; ++j) {
            const vec3 sum = (float)i * (v[1] - v[0]) + (float)j * (v[2] - v[0]);
            const float n = (float)steps;
            const vec3 p = v[0] + vec3{sum[0] / n, sum[1] / n, sum[2] / n};
            call.mark(b, 2, p[0], p[1], p[2]);
        }
}

// Mark the voxels of a group of faces.
NR_FUNC void mark_surface(const MarkSurface& call, int task) {
    const int b = task / call.groups;
    const vec3* vertices = call.vertices + (int64)b * call.vertex_count;
    for (int f = task % call.groups; f < call.face_count; f += call.groups) {
        const int* corners = call.faces + 3 * (int64)f;
        const vec3 v[3] = {vertices[corners[0]], vertices[corners[1]], vertices[corners[2]]};
        mark_points(call, b, v);
        for (int axis = 0; axis < 3; ++axis) mark_lines(call, b, axis, v);
    }
}

// Whether a voxel is at the border of the grid or has an outside neighbour.
NR_FUNC bool is_reached(const Grids& grids, int b, int i, int j, int k) {
    const int last = grids.size - 1;
    if (i == 0 || j == 0 || k == 0 || i == last || j == last || k == last) return true;
    return grids.at(b, i - 1, j, k) == OUTSIDE || grids.at(b, i, j - 1, k) == OUTSIDE
        || grids.at(b, i, j, k - 1) == OUTSIDE || grids.at(b, i + 1, j, k) == OUTSIDE
        || grids.at(b, i, j + 1, k) == OUTSIDE || grids.at(b, i, j, k + 1) == OUTSIDE;
}

// Sweep forwards and backwards over a grid until no new voxel is outside; except for mazes, a few sweeps suffice.
NR_FUNC void flood(const Grids& grids, int b) {
    const int size = grids.size, count = size * size * size;
    bool backward = false;
    for (bool changed = true; changed; backward = !backward) {
        changed = false;
        for (int step = 0; step < count; ++step) {
            const int at = backward ? count - 1 - step : step;
            const int i = at / (size * size), j = (at / size) % size, k = at % size;
            byte& voxel = grids.at(b, i, j, k);
            if (voxel == EMPTY && is_reached(grids, b, i, j, k)) voxel = OUTSIDE, changed = true;
        }
    }
}

struct FloodLines {
    Grids grids;
    int axis;
    int* changed;  // [1], 1 if any voxel is new
};

// Sweep along one line of voxels, forward and backward. It reads and writes no other voxels.
NR_FUNC void flood_line(const FloodLines& call, int task) {
    const int size = call.grids.size, b = task / (size * size), p = (task / size) % size, q = task % size;
    const bool at_border = p == 0 || q == 0 || p == size - 1 || q == size - 1;
    bool outside = true;  // before the first voxel
    for (int step = 0; step < 2 * size; ++step) {
        if (step == size) outside = true;
        byte& voxel = call.grids.across(b, call.axis, p, q, step < size ? step : 2 * size - 1 - step);
        if (voxel == EMPTY && (outside || at_border)) voxel = OUTSIDE, store_relaxed(call.changed, 1);
        outside = voxel == OUTSIDE;
    }
}

struct NearestOnLine {
    const float* lines;  // squared distance of each voxel along other axes, [lines, size]
    int size;            // voxels
    float* nearest;      // squared distance along this axis, too, [lines, size]
};

// Find the least squared distance of each voxel of a line.
NR_FUNC void find_nearest_on_line(const NearestOnLine& call, int task) {
    const float* line = call.lines + (int64)task * call.size;
    for (int i = 0; i < call.size; ++i) {
        float best = line[i];
        for (int j = 0; j < call.size; ++j) best = min(line[j] + (float)((i - j) * (i - j)), best);
        call.nearest[(int64)task * call.size + i] = best;
    }
}

}  // namespace nr
