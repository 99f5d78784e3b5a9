// The unbiased gradient of an image through visibility: an integral along visible boundaries, sampled by scan lines.
//
// `raster/visibility/edge.py` describes the maths and its limits (Li et al., "Differentiable Monte Carlo ray tracing
// through edge sampling", 2018, section 4, here for the pixel grid). Each edge of a visible face is either an outline,
// across which lies the background or a farther face, or a seam, across which lies an adjacent face of the surface. For
// intersections of faces see `intersections.h`.
#pragma once

#include "corner_values.h"
#include "edge_hashes.h"
#include "neighbors.h"

namespace nr {

constexpr float SAME_DEPTH = 1e-5f;  // relative difference of nearness up to which two surfaces meet
constexpr float SAME_PLACE = 0.02f;  // pixels between the ends up to which two surfaces meet
// Largest area of a small face, in pixels. Measured: below it the face's centroid is rarely visible; above it, the
// centroid gives a less noisy gradient.
constexpr float SMALL_AREA = 1.5f;

// Hashes of the colours along each edge, as from `edge_hashes.h`, [images, count, 3, 2]. Images and faces past the end
// share the last ones.
struct EdgeHashes {
    const int64* values;  // null if there are no seams
    int images, count;

    NR_FUNC int64 of(int image, int face, int edge, int back) const {
        const int64 own = (int64)broadcast(image, images) * count + broadcast(face, count);
        return values[(own * 3 + edge) * 2 + back];
    }
};

// The edges of faces that may be visible boundaries.
struct Edges {
    Scene scene;
    Pictures pictures;
    Neighbors neighbors;  // ``adjacent``; on CUDA also the half-edges, by which `queue_moving_face` finds it
    const int* folds;     // faces that the surface folds back to across each edge, [images, count, 3]; or null
    const int* visible;   // mask of visible faces, [images, count + 1]
    byte* steps;          // as from `count_steps`, [images, 1 + count]; null on CUDA
    int seams;            // whether colours may jump between adjacent faces
    EdgeHashes edge_hashes;
    LitCubes textures;  // instead of hashes; null texels if there are hashes
    Queue queue;        // faces that may have an edge to move; on CUDA

    NR_FUNC const int* adjacent(int image, int f) const {
        return neighbors.adjacent + ((int64)image * scene.count + f) * 3;
    }
    NR_FUNC byte* steps_of(int image) const { return steps + (int64)image * (scene.count + 1) + 1; }
};

// ---- Outlines ----
//
// The chord of a face is the length of a scan line inside the face. A pixel centre hits a chord shorter than a pixel
// with a probability equal to its length, so the crossing is weighted by the inverse (importance weight). If the
// surface continues behind the chord, a centre in the next faces, the chain of stand-ins, shows the outline as well,
// and the chord extends through them.
//
// Two surfaces may meet at an edge without being adjacent, as at a T-junction, where a corner of one lies on an edge of
// the other. Each then gets half of the gradient. This is exact if they move together, and ignores a gap that opens.

// Fraction of the gradient that goes to this edge rather than to the face at the outer pixel: none if that face passes
// in front of the crossing, so that it hides or cuts the edge; half if it ends there at the same depth.
NR_FUNC float part_beside_face(const Lines& lines, const BoundaryEdge& edge, const Crossing& at) {
    const vec3* corners = lines.faces + (int64)at.outer_face * 3;
    const float ahead = lead_over_face(lines, edge, at, at.outer_face, at.v);
    if (fabsf(ahead) > SAME_DEPTH * fabsf(edge.nearness_at(lines, at))) return ahead > 0.0f ? 1.0f : 0.0f;
    for (int k = 0; k < 3; ++k) {
        const vec3 &a = corners[k], &b = corners[k == 2 ? 0 : k + 1];
        const float au = lines.u_of(a), bu = lines.u_of(b), av = lines.v_of(a), u = (float)at.u;
        if ((au <= u) == (bu <= u)) continue;
        if (fabsf(av + (lines.v_of(b) - av) * (u - au) / (bu - au) - at.v) < SAME_PLACE) return 0.5f;
    }
    return ahead > 0.0f ? 1.0f : 0.0f;
}

// The offset of a pixel that shows a face, among the 3 x 3 pixels around its centroid; -1 for none.
NR_FUNC int64 middle_of_face(const Lines& lines, int f) {
    const vec3* v = lines.faces + (int64)f * 3;
    const int height = lines.height, width = lines.width;
    const float x = to_pixels((v[0][0] + v[1][0] + v[2][0]) / 3.0f, width);
    const float y = to_pixels((v[0][1] + v[1][1] + v[2][1]) / 3.0f, lines.whole) - (float)lines.below;
    if (!(fabsf(x) < 32768.0f && fabsf(y) < 32768.0f)) return -1;
    const int i = (int)floorf(x + 0.5f), j = (int)floorf(y + 0.5f);
    // The pixel itself, its four edge neighbours, then its four corner neighbours.
    const int right[9] = {0, 1, -1, 0, 0, 1, 1, -1, -1}, up[9] = {0, 0, 0, 1, -1, 1, -1, 1, -1};
    for (int n = 0; n < 9; ++n) {
        const int column = i + right[n], row = height - 1 - (j + up[n]);
        if (column < 0 || column >= width || row < 0 || row >= height) continue;
        const int64 pixel = (int64)row * width + column;
        if (lines.shown[pixel] == f) return pixel;
    }
    return -1;
}

// The first stand-in behind a chord shorter than a pixel.
struct StandIn {
    int face = -1;
    float end;  // distance from the crossing to where the line leaves it
};

// Blend the inner colour of an outline whose face has a chord below a pixel: its stand-in's colour, which counts at any
// shift, plus the face's difference from it at the shifts whose centres hit the chord. The weights of these have the
// mean 1 over all shifts, and the mean distance 0 from the outline, so that a linear colour is that at the outline.
// The stand-in's colour must not depend on the shift: it is extrapolated to the outline if two centres behind the chord
// show the stand-in at any shift; otherwise it is that of a pixel at its centroid. Returns whether the colour is known.
NR_FUNC bool blend_stand_in(
    const Lines& lines, const BoundaryEdge& edge, const Crossing& at, const StandIn& behind, float chord, float weight,
    Gain& gain) {
    const bool hit = at.inner_face == edge.face;
    const float place = min(at.offset / max(chord, SHORTEST), 1.0f);
    const float own = hit ? (4.0f - 6.0f * place) * weight_of_chord(chord) : 0.0f;
    if (weight == 1.0f && behind.end >= 2.0f + chord) {
        const int first = at.inner - (hit ? edge.outward : 0), second = first - edge.outward;
        if (lines.face(at.u, first) != behind.face || lines.face(at.u, second) != behind.face) return false;
        if (!hit) return gain.inside.extrapolate(1.0f, at.offset, true), true;
        gain.inside.third = lines.pixel(at.u, second);
        gain.inside.near_weight = own;
        gain.inside.next_weight = 2.0f + at.offset - 2.0f * own;
        gain.inside.third_weight = own - 1.0f - at.offset;
        return true;
    }
    const int64 middle = middle_of_face(lines, behind.face);
    if (middle < 0) return false;
    gain.inside.next = middle;
    gain.inside.near_weight = own;
    gain.inside.next_weight = weight - own;
    return true;
}

// By how many pixels more to extrapolate the colour of a face that two centres of a line show, although its chord is
// shorter than two pixels. At other shifts one centre alone shows the face, half of (2 - chord) chord pixels from the
// outline in the mean over all shifts, and its colour is not extrapolated. The mean over shifts is then exact.
NR_FUNC float more_extrapolation(float chord) {
    return chord >= 2.0f ? 0.0f : 0.5f * max(2.0f - chord, 0.0f) * chord / max(chord - 1.0f, 0.1f);
}

// The depth order at the end of a chord shorter than a pixel, where the previous pixel shows another surface: -1 if the
// surface lies behind the chord, but in front of the outer side, so that it replaces the chord at all other shifts; 1
// if it lies in front of the chord, so that its own outline does; 0 if it lies behind both.
NR_NOINLINE int beyond_chord(const Lines& lines, const BoundaryEdge& edge, const Crossing& at, int before, float end) {
    const int reaches = lines.follow(before, at.u, end, edge.outward);
    const float lead = lead_over_face(lines, edge, at, reaches < 0 ? before : reaches, end);
    if (lead <= 0.0f) return 1;
    return at.outer_face < 0 || lead < lead_over_face(lines, edge, at, at.outer_face, at.v) ? -1 : 0;
}

// Pass the gain at a crossing to the sink; the background or a farther face lies outside.
template <class Sink>
NR_NOINLINE void gain_of_outline(const Lines& lines, const BoundaryEdge& edge, const Crossing& at, Sink& sink) {
    if (at.inner_face < 0 || (!lines.image && at.outer_face >= 0)) return;  // both sides of a silhouette are 1
    // Chords from the crossing on: in the face, and, at most a pixel, in the face and in it and its stand-ins.
    float reach = 2.0f, own = 1.0f, joint = 1.0f, exit = at.v;
    StandIn stand_in;
    const int before = lines.face(at.u, at.inner - edge.outward);
    const bool is_own = at.inner_face == edge.face;
    bool shows = is_own, shows_before = false;   // the inner pixel, and the previous one
    bool ends = false;                           // whether the surface ends behind a chord shorter than a pixel
    if (!lines.perspective || edge.rz > 0.0f) {  // otherwise the third corner is behind the camera
        int next = edge.leave(at.u, edge.third, exit);
        reach = fabsf(exit - at.v), own = joint = min(reach, 1.0f);
        // Behind a chord shorter than a pixel, follow the surface along the line.
        stand_in.face = joint < 1.0f ? next : -1;
        for (int n = 0; n < LONGEST && next >= 0 && joint < 1.0f; ++n) {
            shows |= at.inner_face == next, shows_before |= before == next;
            next = lines.cross(next, at.u, exit);
            joint = min(fabsf(exit - at.v), 1.0f);
            if (n == 0) stand_in.end = fabsf(exit - at.v);
        }
        ends = next < 0 && joint < 1.0f;
    }
    if (!shows) return;
    sink.part = at.outer_face >= 0 ? part_beside_face(lines, edge, at) : 1.0f;
    if (sink.part == 0.0f) return;
    const int beyond = ends && before >= 0 && !shows_before ? beyond_chord(lines, edge, at, before, exit) : 0;
    const float weight = beyond > 0 ? 1.0f : weight_of_chord(joint);
    if (beyond > 0) stand_in.face = -1;
    Gain gain(lines, edge, at);
    gain.outside.extrapolate(beyond ? 1.0f : weight, 1.0f - at.offset, gain.behind_is_outside);
    if (beyond < 0) gain.outside.third = gain.inside.next, gain.outside.third_weight = weight - 1.0f;
    const EdgePixels pixels(lines, at, weight > 1.0f);
    if (lines.sampled > 0) {
        const bool blends = lines.image && stand_in.face >= 0;  // a silhouette has one colour
        if (!blends || !blend_stand_in(lines, edge, at, stand_in, own, weight, gain)) {
            const float more = is_own && weight == 1.0f ? more_extrapolation(reach) : 0.0f;
            gain.inside.extrapolate(weight, at.offset + more, gain.before_is_inside);
            if (shows_before && is_own) {
                // The stand-in's colour, plus the face's difference from it, with the larger weight of the face's own
                // chord, which centres hit less often.
                gain.inside.near_weight = weight_of_chord(own);
                gain.inside.next_weight = weight - gain.inside.near_weight;
            }
        }
        gain.give(lines, pixels, sink);
    }
    if (lines.corner_values) {
        const EdgeValues values(lines, edge, at);
        const ValuesBehind behind(lines, edge, at, beyond ? 1.0f : weight);
        if (behind.known) gain.outside.near_weight = gain.outside.next_weight = 0.0f;
        for (int c = lines.sampled; c < lines.channels; ++c)
            sink(c, pixels, weight * values.of(c) - behind.of(lines, c) - gain.outside.of(lines, c));
    }
}

// ---- Seams ----
//
// The gradient at a seam needs the colours of both faces, from pixels that show them. The pixels next to the seam may
// miss a narrow face; its colour then comes from the pixel at its centroid.
//
// Possibly no pixel shows a small face, so the two sides are estimated independently by the Horvitz-Thompson estimator
// (1952): a side counts only if its pixel shows its face, divided by the probability of that, its chord. Subtracting
// one colour from both sides does not change their difference, but removes most of the noise (a control variate): a
// line fitted to the colours of other faces nearby, evaluated at the crossing. Their mean would be biased, since it
// moves with the pixel grid: for slowly changing colours, the gain would be 1 / chord times too large.
//
// Rejected: searching the next scan lines, too, for pixels that show the face. The noise at triangles of two pixels
// falls from 0.8 to 0.45 of the gradient, but the estimate takes 1.4 to 1.6 times as long.

NR_FUNC bool is_small(const Scene& scene, int image, int f) {
    const vec3* v = scene.corners(image, f);
    const vec3 s = v[1] - v[0], t = v[2] - v[0];
    return fabsf(s[0] * t[1] - s[1] * t[0]) * (float)scene.whole_height() * (float)scene.width / 8.0f < SMALL_AREA;
}

// Pass the gains of both sides, estimated independently, to the sink.
template <class Sink>
NR_FUNC void gain_of_sides(
    const Lines& lines, const BoundaryEdge& edge, const Crossing& at, bool shows_own, bool shows_adjacent, Sink& sink) {
    if (!(shows_own || shows_adjacent)) return;
    // Pixels around the pair: two on either side along the line, and those on the neighbouring lines.
    const int d = edge.outward;
    const int across[8] = {0, 0, 0, 0, -1, -1, 1, 1}, along[8] = {-1, -2, 2, 3, 0, 1, 0, 1};
    int64 around[8];
    float places[8], sum = 0.0f, square = 0.0f;  // pixels from the inner centre outward, their sum and their spread
    int count = 0;
    for (int n = 0; n < 8; ++n) {
        const int u = at.u + across[n], v = at.inner + d * along[n];
        if (u < 0 || u >= lines.count || v < 0 || v >= lines.length) continue;
        const int64 pixel = lines.pixel(u, v);
        const int shown = lines.shown[pixel];
        if (shown < 0 || shown == edge.face || shown == edge.adjacent) continue;
        around[count] = pixel, places[count++] = (float)along[n], sum += (float)along[n];
    }
    const float center = count > 0 ? sum / (float)count : 0.0f;
    for (int n = 0; n < count; ++n) square += (places[n] - center) * (places[n] - center);
    const float to_crossing = square > 0.0f ? (at.offset - center) / square : 0.0f;
    // A clamped weight loses part of its side's gradient. The other side loses the same part, so that constants cancel.
    const float to_own = lines.chord(edge.face, at.u, at.v, at.v);
    const float to_adjacent = lines.chord(edge.adjacent, at.u, at.v, at.v);
    const float both = weight_of_chord(to_own) * weight_of_chord(to_adjacent);
    const float own = shows_own ? both * to_adjacent : 0.0f, adjacent = shows_adjacent ? both * to_own : 0.0f;
    const int64 inner = lines.pixel(at.u, at.inner), outer = lines.pixel(at.u, at.outer);
    // Without other faces, subtract the colour of the side that is more often visible.
    const int64 middle = shows_own && (!shows_adjacent || own <= adjacent) ? inner : outer;
    const EdgePixels pixels(lines, at, true);
    for (int c = 0; c < lines.sampled; ++c) {
        float mean = 0.0f, slope = 0.0f;
        for (int n = 0; n < count; ++n) {
            const float value = lines.value(c, around[n]);
            mean += value, slope += (places[n] - center) * value;
        }
        const float nearby = count > 0 ? mean / (float)count + slope * to_crossing : lines.value(c, middle);
        sink(c, pixels, own * (lines.value(c, inner) - nearby) - adjacent * (lines.value(c, outer) - nearby));
    }
}

// Pass the gain at a crossing to the sink, unless a colour is unknown or another face hides the seam.
template <class Sink>
NR_FUNC void gain_of_seam(const Lines& lines, const BoundaryEdge& edge, const Crossing& at, Sink& sink) {
    if (lines.sampled == 0) return gain_of_known_seam(lines, edge, at, sink);
    const bool shows_own = at.inner_face == edge.face, shows_adjacent = at.outer_face == edge.adjacent;
    if (edge.small) return gain_of_sides(lines, edge, at, shows_own, shows_adjacent, sink);
    Gain gain(lines, edge, at);
    // If a centre lies in a face but does not show it, another face hides the seam.
    if (!shows_own) {
        if (at.offset < lines.chord(edge.face, at.u, at.v, at.v)) return;
        gain.inside.near = middle_of_face(lines, edge.face);
        if (gain.inside.near < 0) return;
    }
    if (!shows_adjacent) {
        if (1.0f - at.offset < lines.chord(edge.adjacent, at.u, at.v, at.v)) return;
        gain.outside.near = middle_of_face(lines, edge.adjacent);
        if (gain.outside.near < 0) return;
    }
    // A colour from the centroid is not extrapolated.
    gain.inside.extrapolate(1.0f, at.offset, gain.before_is_inside && shows_own);
    gain.outside.extrapolate(1.0f, 1.0f - at.offset, gain.behind_is_outside && shows_adjacent);
    gain.give(lines, EdgePixels(lines, at, false), sink);
}

// ---- Which edges move ----

// Whether the colours along edge k of face f equal those along the same edge of the adjacent face g. A hash of 0 never
// matches.
NR_FUNC bool colors_continue(const Edges& call, int image, int f, int k, int g) {
    const bool hashed = !call.textures.texels;
    const int64 own = hashed ? call.edge_hashes.of(image, f, k, 0) : 0;
    if (hashed && own == 0) return false;
    const vec3 *v = call.scene.corners(image, f), *u = call.scene.corners(image, g);
    for (int m = 0; m < 3; ++m)
        if (same(u[(m + 1) % 3], v[k]) && same(u[m], v[(k + 1) % 3]))
            return hashed ? call.edge_hashes.of(image, g, m, 1) == own
                          : same_colors(call.scene, call.textures, image, f, k, g, m);
    return false;
}

// Whether a surface folds at edge k of face f, and the other face of the fold is in front of f.
NR_FUNC bool folds_behind(const Edges& call, int image, int f, int k) {
    if (!call.folds) return false;
    const Scene& scene = call.scene;
    const int other = call.folds[((int64)image * scene.count + f) * 3 + k];
    if (other < 0) return false;
    const vec3 *v = scene.corners(image, other), &r = scene.corners(image, f)[(k + 2) % 3];
    if (scene.perspective && ((v[0][2] <= 0.0f) | (v[1][2] <= 0.0f) | (v[2][2] <= 0.0f) | (r[2] <= 0.0f))) return false;
    return nearness_at(v, r[0], r[1], scene.perspective) > nearness(r[2], scene.perspective);
}

// Whether pixels can show the colours of both faces of a seam: both are visible, or one is and one of them is small.
NR_FUNC bool may_be_known(const Edges& call, int image, int f, int g) {
    const int* shown = call.visible + (int64)image * (call.scene.count + 1);
    if (call.pictures.known == call.pictures.channels || (shown[f] && shown[g])) return true;
    return (shown[f] || shown[g]) && (is_small(call.scene, image, f) || is_small(call.scene, image, g));
}

// Whether edge k of a face is an outline, or a seam to a face of higher index (each seam counts once).
NR_FUNC bool may_move(const Edges& call, int image, int f, int k) {
    const int other = call.adjacent(image, f)[k];
    if (other < 0) return !folds_behind(call, image, f, k);
    if (!call.seams || other < f || !may_be_known(call, image, f, other)) return false;
    return !colors_continue(call, image, f, k, other);
}

// Count the steps over adjacent faces from each face of an image to the nearest visible one, at most LONGEST + 1. Each
// pass finds the faces one step farther away. A search from each face took up to half of the gradient's time.
NR_FUNC void count_steps(const Edges& call, int image) {
    const int count = call.scene.count;
    const int *shown = call.visible + (int64)image * (count + 1), *next = call.adjacent(image, 0);
    byte* steps = call.steps_of(image);
    steps[-1] = LONGEST + 1;  // where there is no adjacent face
    for (int f = 0; f < count; ++f) steps[f] = shown[f] ? 0 : LONGEST + 1;
    bool found = true;
    for (int n = 1; found && n <= LONGEST; ++n) {
        found = false;
        for (int f = 0; f < count; ++f) {
            const int* to = next + 3 * (int64)f;
            const int least = min(steps[to[0]], min(steps[to[1]], steps[to[2]]));
            const bool is_next = steps[f] > n && least < n;
            steps[f] = is_next ? (byte)n : steps[f];
            found |= is_next;
        }
    }
}

// Whether an edge of the face may be a visible boundary. The outline of a face that all pixel centres miss is visible
// if a face behind it is; a seam, if the adjacent face is, or, with known values, a neighbour of that face.
NR_FUNC bool has_moving_edge(const Edges& call, int image, int f) {
    const int* shown = call.visible + (int64)image * (call.scene.count + 1);
    const int *all = call.adjacent(image, 0), *next = all + 3 * (int64)f;
    const bool has_outline = next[0] < 0 || next[1] < 0 || next[2] < 0;
    if (shown[f]) return call.seams || has_outline;
    if (has_outline && call.steps) return call.steps_of(image)[f] <= LONGEST;
    if (has_outline) return next[0] >= 0 || next[1] >= 0 || next[2] >= 0;  // on CUDA, it counts as visible
    if (!call.seams || shown[next[0]] || shown[next[1]] || shown[next[2]]) return call.seams;
    if (call.pictures.known < call.pictures.channels || !is_small(call.scene, image, f)) return false;
    bool beside = false;
    for (int n = 0; n < 9; ++n) {
        const int g = all[3 * (int64)next[n / 3] + n % 3];
        beside |= g >= 0 && shown[g];
    }
    return beside;
}

// ---- Kernels ----

// Edge k of a face, counter-clockwise from corner p to corner q.
struct FaceEdge {
    BoundaryEdge edge;

    NR_FUNC FaceEdge(const Edges& call, int image, int f, const Lines& lines, int k, bool clockwise)
        : edge(of_corners(call.scene.corners(image, f), lines, k, clockwise)) {
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        const int* next = call.adjacent(image, f);
        edge.face = f, edge.adjacent = next[k];
        edge.third.at_p = next[clockwise ? m : n], edge.third.at_q = next[clockwise ? n : m];
        if (edge.adjacent < 0 || !edge.has_crossings()) return;
        const Scene& scene = call.scene;
        if (lines.sampled == 0) match_corners(scene.corners(image, f), lines);
        else edge.small = is_small(scene, image, f) || is_small(scene, image, edge.adjacent);
    }
    NR_FUNC static BoundaryEdge of_corners(const vec3* corners, const Lines& lines, int k, bool clockwise) {
        const int m = (k + 1) % 3, p = clockwise ? m : k, q = clockwise ? k : m;
        BoundaryEdge edge(lines, corners[p], corners[q], corners[(k + 2) % 3]);
        edge.p = p, edge.q = q;
        return edge;
    }
    // Find the ends among the corners of the adjacent face, and its third corner.
    NR_FUNC void match_corners(const vec3* v, const Lines& lines) {
        const vec3* u = lines.faces + (int64)edge.adjacent * 3;
        int p = 0, q = 0, s = 0;
        for (int n = 0; n < 3; ++n) {
            if (same(u[n], v[edge.p])) p = n;
            else if (same(u[n], v[edge.q])) q = n;
            else s = n;
        }
        edge.across_p = lines.known_value(edge.adjacent, p), edge.across_q = lines.known_value(edge.adjacent, q);
        const int* next = lines.adjacent + (int64)edge.adjacent * 3;
        edge.across = {lines.u_of(u[s]), lines.v_of(u[s]), next[(q + 1) % 3], next[(p + 1) % 3]};
    }
    // Call visit(at) for the crossings with the lines of a task between pixels that show different faces.
    template <class Visit>
    NR_FUNC void over_crossings(const LineTask& task, const Lines& lines, Visit visit) const {
        const int end = min(edge.end, task.last);
        for (int u = max(edge.first, task.first) + task.part; u < end; u += task.parts) {
            const Crossing at = edge.crossing(lines, u);
            if ((at.inner_face == -2) | (at.outer_face == -2) | (at.inner_face == at.outer_face)) continue;
            visit(at);
        }
    }
    template <class Sink>
    NR_FUNC void gain(const Lines& lines, const Crossing& at, Sink& sink) const {
        if (edge.adjacent >= 0) gain_of_seam(lines, edge, at, sink);
        else gain_of_outline(lines, edge, at, sink);
    }
    // Outward motion of a crossing in pixels if an end moves by 1 in screen units.
    NR_FUNC float scale(const Lines& lines) const {
        return 0.5f * lines.share_of_pixel() * (float)(edge.outward * lines.whole_length());
    }
};

struct EdgeBackward {
    Edges edges;
    vec3* to_faces;  // gradient to the corners, [images, count, 3], 0 before
};

// Add the gradient of edge k of a face to its ends p and q, along one axis, from the scan lines of a task.
NR_FUNC void move_edge(const Edges& call, const LineTask& task, const Lines& lines, int k, bool clockwise, vec3* to) {
    const FaceEdge own(call, task.image, task.face, lines, k, clockwise);
    float to_p = 0.0f, to_q = 0.0f;
    own.over_crossings(task, lines, [&](const Crossing& at) {
        Adjoint adjoint = {lines};
        own.gain(lines, at, adjoint);
        const float gain = adjoint.part * adjoint.sum * border_weight(at.v, lines.length);
        to_p += (1.0f - at.share) * gain, to_q += at.share * gain;
    });
    const float scale = own.scale(lines);
    to[own.edge.p][lines.axis] += scale * to_p, to[own.edge.q][lines.axis] += scale * to_q;
}

// Process one face of one image, over the scan lines of a task.
NR_NOINLINE void move_face(const EdgeBackward& backward, const LineTask& task) {
    const Edges& call = backward.edges;
    const Scene& scene = call.scene;
    const bool clockwise = facing(scene.corners(task.image, task.face), scene.perspective) < 0;
    const Lines rows(0, scene, call.pictures, call.neighbors.adjacent, task.image);
    const Lines columns(1, scene, call.pictures, call.neighbors.adjacent, task.image);
    vec3 to[3] = {};
    for (int k = 0; k < 3; ++k) {
        if (!may_move(call, task.image, task.face, k)) continue;
        move_edge(call, task, rows, k, clockwise, to);
        move_edge(call, task, columns, k, clockwise, to);
    }
    vec3* corners = backward.to_faces + ((int64)task.image * scene.count + task.face) * 3;
    for (int k = 0; k < 3; ++k) {
        if (call.queue.threads == 0) corners[k] = to[k];
        else atomic_add_nonzero(corners + k, to[k]);
    }
}

// Process a face with a possible boundary edge; on CUDA, one scan line at a time from the queue.
NR_FUNC void edge_backward(const EdgeBackward& backward, int task) {
    const Edges& call = backward.edges;
    const int count = call.scene.count;
    if (call.queue.threads == 0 && !has_moving_edge(call, task / count, task % count)) return;
    for_each_line_task(call.queue, call.scene, task, 1, 1, [&](const LineTask& own) { move_face(backward, own); });
}

// Append a face with a possible boundary edge to the queue. With half-edges, first find its adjacent faces.
NR_FUNC void queue_moving_face(const Edges& call, int task) {
    const int image = task / call.scene.count, f = task % call.scene.count;
    if (call.neighbors.half_edges.siblings) search_half_edges(call.neighbors, image, f);
    if (has_moving_edge(call, image, f)) put_lines(call.queue, call.scene, image, f, 1, 1);
}

// The tangents of images for several tangents of the corners: the transpose of `EdgeBackward`.
struct EdgeForward {
    Edges edges;
    const vec3* motion;  // of the corners, [directions, images, count, 3]
    int directions;
    // Scan lines: 0 for rows, 1 for columns. On the CPU a task processes all faces of an image over a band of ``band``
    // lines of one axis, so that no two tasks write to one pixel. On CUDA it processes both axes.
    int axis, band;
    byte* moving;   // bit k: whether edge k of a face may be a visible boundary, [images, count]; on the CPU
    float* images;  // [directions, images, channels, height, width] or halved; added to
};

// Bit mask of the edges of a face that may be visible boundaries: bit k for edge k.
NR_FUNC int moving_edges(const Edges& call, int image, int f) {
    int bits = 0;
    for (int k = 0; k < 3; ++k) bits |= may_move(call, image, f, k) ? 1 << k : 0;
    return bits;
}

// Find the edges of a face that may be visible boundaries, for the launches of both axes.
NR_FUNC void find_moving_edges(const EdgeForward& forward, int task) {
    const int count = forward.edges.scene.count, image = task / count, f = task % count;
    const bool any = has_moving_edge(forward.edges, image, f);
    forward.moving[task] = (byte)(any ? moving_edges(forward.edges, image, f) : 0);
}

// Process the edges in the mask ``moving`` of one face, along one axis, over the scan lines of a task.
NR_NOINLINE void face_forward(const EdgeForward& forward, const LineTask& task, int axis, int moving) {
    const Edges& call = forward.edges;
    const Scene& scene = call.scene;
    const int b = task.image, f = task.face;
    const bool clockwise = facing(scene.corners(b, f), scene.perspective) < 0;
    const Lines lines(axis, scene, call.pictures, call.neighbors.adjacent, b);
    const vec3* motion = forward.motion + ((int64)b * scene.count + f) * 3;
    const int64 step = (int64)scene.images * scene.count * 3, size = lines.channels * lines.grad_area;
    for (int k = 0; k < 3; ++k) {
        if (!(moving >> k & 1)) continue;
        const FaceEdge own(call, b, f, lines, k, clockwise);
        own.over_crossings(task, lines, [&](const Crossing& at) {
            const float scale = own.scale(lines) * border_weight(at.v, lines.length);
            for (int first = 0; first < forward.directions; first += Tangent::MOST) {
                float* image = forward.images + (first * (int64)scene.images + b) * size;
                Tangent tangent = {
                    lines, min(forward.directions - first, Tangent::MOST), image, scene.images * size, {}};
                const vec3* by = motion + first * step;
                for (int t = 0; t < tangent.directions; ++t, by += step)
                    tangent.motion[t] =
                        scale * ((1.0f - at.share) * by[own.edge.p][axis] + at.share * by[own.edge.q][axis]);
                own.gain(lines, at, tangent);
            }
        });
    }
}

// Process the faces of an image over a band of lines; on CUDA, one scan line at a time from the queue.
NR_FUNC void edge_forward(const EdgeForward& forward, int task) {
    const Edges& call = forward.edges;
    const Scene& scene = call.scene;
    if (call.queue.threads > 0) {
        for_each_line_task(call.queue, scene, task, 1, 1, [&](const LineTask& own) {
            const int moving = moving_edges(call, own.image, own.face);
            for (int axis = 0; axis < 2; ++axis) face_forward(forward, own, axis, moving);
        });
        return;
    }
    const int lines = forward.axis ? scene.width : scene.height;
    const int bands = (lines + forward.band - 1) / forward.band, image = task / bands;
    const int first = task % bands * forward.band, last = min(first + forward.band, lines);
    for (int f = 0; f < scene.count; ++f) {
        const int moving = forward.moving[(int64)image * scene.count + f];
        if (!moving) continue;
        const Box box = box_of_face(scene, image, f);
        if (forward.axis ? box.right < first || box.left >= last : box.top < first || box.bottom >= last) continue;
        face_forward(forward, LineTask{image, f, 0, 1, 0, 1, first, last}, forward.axis, moving);
    }
}

}  // namespace nr
