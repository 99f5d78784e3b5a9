// The adjacent face across each edge, where the surface continues on the screen.
//
// The adjacent face is the drawn face of lowest index that has the same two corners, equal to the last bit, and lies on
// the other side of the edge on the screen. The mesh's half-edges find it, or a hash table of corners.
#pragma once

#include "geometry.h"

namespace nr {

// Most faces examined at one edge. Without a limit, a stack of equal faces would take quadratic time.
constexpr int MOST_EQUALS = 8;

// Sibling half-edges (`half_edges.py`): edge k of face f has the number 3 f + k, and names the next edge with the same
// two vertices.
struct HalfEdges {
    const int* siblings;  // [owners, count, 3]; null if there are none
    int owners;           // images of half-edges; 1 if all share them

    NR_FUNC const int* of_image(int image, int count) const {
        return siblings + (int64)broadcast(image, owners) * count * 3;
    }
    // Whether an edge has no sibling, so that only the table can find its neighbour.
    NR_FUNC bool is_boundary(int image, int count, int edge) const {
        return !siblings || of_image(image, count)[edge] == edge;
    }
};

// A face is seen edge-on up to this width on the screen, relative to its largest coordinate.
constexpr float EDGE_ON = 2e-5f;

struct Neighbors {
    Scene scene;    // without a face index
    int two_sided;  // whether faces whose corners run clockwise on the screen are drawn
    int side;       // -1 to find faces on the other side of an edge, 1 for those on the same side, at a fold
    HalfEdges half_edges;
    int* table;     // edges as 3 f + k + 1, [images, size], 0 before
    int size;       // slots of the table of an image, a power of two
    int lanes;      // tasks that fill the table of an image
    byte* turns;    // as from `turn_of_face`, [images, count]; null where each task finds those that it needs
    int* adjacent;  // result, [images, count, 3]; -1 for none, and for faces that are not drawn
};

// Whether two corners are equal; 0 equals -0.
NR_FUNC bool same(const vec3& a, const vec3& b) { return a[0] == b[0] && a[1] == b[1] && a[2] == b[2]; }

// Whether a face is seen edge-on. Rounding decides how it runs on the screen, so it counts as not drawn: its neighbours
// have an outline there, not the face without any width.
NR_FUNC bool is_edge_on(const vec3* v) {
    float largest = 0.0f;
    for (int k = 0; k < 3; ++k) largest = max(largest, max(fabsf(v[k][0]), fabsf(v[k][1])));
    return is_narrow(v, EDGE_ON * largest);
}

// How a face runs on the screen: 1 counter-clockwise, 2 clockwise; 0 if it is not drawn, because its visible side is
// not wanted, it is seen edge-on, or it is wholly behind the camera.
NR_FUNC int turn_of(const Neighbors& call, int image, int f) {
    const Scene& scene = call.scene;
    if (call.turns) return call.turns[(int64)image * scene.count + f];
    const vec3* v = scene.corners(image, f);
    const int side = facing(v, scene.perspective);
    const bool drawn = ((side > 0) | ((side < 0) & (call.two_sided != 0))) & (in_front(v, scene.perspective) >= 0);
    return drawn && !is_edge_on(v) ? side > 0 ? 1 : 2 : 0;
}

// Whether two drawn faces that share an edge meet there on the wanted side. They run along it in one direction
// (``along``), or in opposite directions.
NR_FUNC bool meet(const Neighbors& call, int turn, int other, bool along) {
    const bool folds = (turn == other) == along;
    return folds == (call.side > 0);
}

// Find the faces adjacent to one face of an image, among its sibling half-edges.
NR_FUNC void search_half_edges(const Neighbors& call, int image, int f) {
    const Scene& scene = call.scene;
    const int* siblings = call.half_edges.of_image(image, scene.count);
    const vec3 *corners = scene.corners(image, 0), *v = corners + 3 * (int64)f;
    int* to = call.adjacent + ((int64)image * scene.count + f) * 3;
    to[0] = to[1] = to[2] = -1;
    const int turn = turn_of(call, image, f);
    if (turn == 0) return;
    for (int k = 0; k < 3; ++k) {
        int entry = siblings[3 * f + k];
        for (int n = 0; n < MOST_EQUALS && entry != 3 * f + k; ++n, entry = siblings[entry]) {
            const int g = entry / 3, other = turn_of(call, image, g);
            // No branches, which would be hard to predict.
            const bool meets = (g != f) & (other != 0) & meet(call, turn, other, same(corners[entry], v[k]));
            to[k] = meets & ((to[k] < 0) | (g < to[k])) ? g : to[k];
        }
    }
}

// Find how one face of one image runs. Its neighbours need it, too, so that of many faces it is found once.
NR_FUNC void turn_of_face(const Neighbors& call, int task) {
    Neighbors unknown = call;
    unknown.turns = nullptr;
    call.turns[task] = (byte)turn_of(unknown, task / call.scene.count, task % call.scene.count);
}

// Process the edges of one face of one image, by their half-edges.
NR_FUNC void search_half_edges_of_face(const Neighbors& call, int task) {
    search_half_edges(call, task / call.scene.count, task % call.scene.count);
}

// The hash of an edge: its first slot in a table of ``size`` slots; the same for both directions.
NR_FUNC int place_of_edge(const vec3& p, const vec3& q, int size) {
    unsigned sum = 0;
    for (int end = 0; end < 2; ++end) {
        unsigned bits = 0x9E3779B9u;
        for (int k = 0; k < 3; ++k) {
            bits = (bits ^ (unsigned)bits_of((end ? q : p)[k] + 0.0f)) * 0x85EBCA6Bu;  // -0 is 0
            bits ^= bits >> 15;
        }
        sum += bits;
    }
    sum = (sum ^ (sum >> 16)) * 0xC2B2AE35u;
    return (int)((sum ^ (sum >> 13)) & (unsigned)(size - 1));
}

// Whether an entry of the table is the edge p - q, in either direction.
NR_FUNC bool same_edge(const vec3* corners, int entry, const vec3& p, const vec3& q) {
    const vec3* v = corners + (int64)((entry - 1) / 3) * 3;
    const vec3 &start = v[(entry - 1) % 3], &end = v[entry % 3];
    return (same(start, p) && same(end, q)) || (same(start, q) && same(end, p));
}

// Insert edge k of face f into a hash table with linear probing, unless the table has MOST_EQUALS equal edges.
NR_FUNC void insert_edge(const Neighbors& call, int image, int f, int k) {
    const vec3 *corners = call.scene.corners(image, 0), *v = corners + 3 * (int64)f;
    int* table = call.table + (int64)image * call.size;
    const vec3 &p = v[k], &q = v[(k + 1) % 3];
    int at = place_of_edge(p, q, call.size), equals = 0;
    int entry = atomic_cas(table + at, 0, 3 * f + k + 1);
    while (entry != 0) {
        equals += same_edge(corners, entry, p, q);
        if (equals == MOST_EQUALS) return;
        at = (at + 1) & (call.size - 1);
        entry = atomic_cas(table + at, 0, 3 * f + k + 1);
    }
}

// Insert the boundary edges of every n-th drawn face of an image.
NR_FUNC void insert_edges(const Neighbors& call, int task) {
    const Scene& scene = call.scene;
    const int image = task / call.lanes;
    for (int f = task % call.lanes; f < scene.count; f += call.lanes) {
        if (turn_of(call, image, f) == 0) continue;
        for (int k = 0; k < 3; ++k)
            if (call.half_edges.is_boundary(image, scene.count, 3 * f + k)) insert_edge(call, image, f, k);
    }
}

// Find the neighbours of one face of one image across its boundary edges, by the table.
NR_FUNC void search_table(const Neighbors& call, int task) {
    const Scene& scene = call.scene;
    const int image = task / scene.count, f = task % scene.count, *table = call.table + (int64)image * call.size;
    const vec3 *corners = scene.corners(image, 0), *v = corners + 3 * (int64)f;
    const int turn = turn_of(call, image, f);
    for (int k = 0; k < 3; ++k) {
        if (turn && !call.half_edges.is_boundary(image, scene.count, 3 * f + k)) continue;
        int& to = call.adjacent[(int64)task * 3 + k];
        to = -1;
        if (!turn) continue;
        int adjacent = -1;
        const vec3 &p = v[k], &q = v[(k + 1) % 3];
        for (int at = place_of_edge(p, q, call.size); table[at] != 0; at = (at + 1) & (call.size - 1)) {
            const int entry = table[at], g = (entry - 1) / 3;
            if (g == f || !same_edge(corners, entry, p, q)) continue;
            const bool along = same(corners[entry - 1], p);
            if (meet(call, turn, turn_of(call, image, g), along) && (adjacent < 0 || g < adjacent)) adjacent = g;
        }
        to = adjacent;
    }
}

}  // namespace nr
