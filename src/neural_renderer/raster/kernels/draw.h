// Drawing finds the nearest face of each pixel. A pixel whose edge functions e are not negative lies in a
// counter-clockwise face; with t = 1 / z of its corners its depth is sum(e) / (e . t), in orthographic projection with
// t = z its inverse. The formulas are the same on both devices, so that results agree to the bit.
//
// On the CPU a task draws all faces into a band of rows of one image. On CUDA one thread draws a small face, and many
// threads share a large one; the atomic minimum of keys made of depth and index is the nearest face.
//
// Edge functions: Pineda, "A parallel algorithm for polygon rasterization", 1988.
#pragma once

#include "lanes.h"
#include "queue.h"
#include "tasks.h"
#include "visible_faces.h"

namespace nr {

struct Drawing {
    const vec3* faces;    // corners on the screen, [images, count, 3]
    const float* behind;  // depth behind which each pixel is drawn, [images, height, width]; null: the near plane's
    int images;
    int count;          // faces of an image
    int height, width;  // pixels
    float near, far;    // limits of depth, which are excluded
    int two_sided;      // whether faces that run clockwise on the screen are drawn
    int perspective;    // whether depth is 1 / sum(w_k / z_k), else sum(w_k z_k)
    int bands;          // bands of rows in an image, a task each; on the CPU
    float* nearest;     // depth of the nearest face, [images, height, width]; on the CPU
    int64* keys;        // bits of the depth, then the index, of the nearest face, [images, height, width]; on CUDA
    Queue queue;        // large faces; on CUDA
    int each;           // rows of a task of `decode_keys`; on CUDA
    int* face_index;    // result, [images, height, width]; row 0 at the top, -1 where there is no face
    int* visible;       // mask of visible faces, [images, count + 1], 0 before; may be null
    int below, above;   // as of `Scene`

    NR_FUNC const vec3* corners(int image, int face) const { return faces + ((int64)image * count + face) * 3; }
    NR_FUNC int64 row_start(int image, int j) const { return ((int64)image * height + height - 1 - j) * width; }
    NR_FUNC int whole_height() const { return below + height + above; }
    template <class Ints>
    NR_FUNC auto centre_of_row(Ints j) const {
        return pixel_centre(below + j, whole_height());
    }
};

// Where drawing begins: at the near plane, or behind a depth of each pixel (depth peeling: Everitt, "Interactive
// order-independent transparency", 2001).
struct BehindNearPlane {
    template <class F>
    static NR_FUNC F depth(const Drawing& call, int64) {
        return all<F>(call.near);
    }
};
struct BehindLayer {
    template <class F>
    static NR_FUNC F depth(const Drawing& call, int64 pixel) {
        return load<F>(call.behind + pixel);
    }
};

// A face to draw, counter-clockwise.
struct DrawnFace {
    vec3 v[3];
    vec3 terms;   // 1 / z of each corner in perspective, else z
    float least;  // a depth below those of all its pixels, rounding included
    int index;    // index of the face, plus the number of faces if its back is visible
    int front;    // class, as from `in_front`; -1 if it is not drawn
};

// Whether a face may be visible between two heights of the screen. Most faces of a fine mesh fail this quick test: they
// are above, below, too near, too far, or back-facing. A face across the camera's plane passes.
NR_FUNC bool may_be_drawn(const Drawing& call, const vec3* v, float low, float high) {
    const float x0 = v[0][0], x1 = v[1][0], x2 = v[2][0], y0 = v[0][1], y1 = v[1][1], y2 = v[2][1];
    const float z0 = v[0][2], z1 = v[1][2], z2 = v[2][2], near = call.near, far = call.far;
    if (call.perspective && !((z0 > 0.0f) & (z1 > 0.0f) & (z2 > 0.0f))) return true;
    const bool below = (y0 < low) & (y1 < low) & (y2 < low), above = (y0 > high) & (y1 > high) & (y2 > high);
    const bool close = (z0 <= near) & (z1 <= near) & (z2 <= near), away = (z0 >= far) & (z1 >= far) & (z2 >= far);
    const float left = (y2 - y0) * (x1 - x0), right = (y1 - y0) * (x2 - x0);
    return !(below | above | close | away) & (call.two_sided ? left != right : left > right);
}

NR_FUNC DrawnFace drawn_face(const Drawing& call, int image, int f, float low, float high) {
    const vec3* v = call.corners(image, f);
    DrawnFace face = {{v[0], v[1], v[2]}, {}, 0.0f, f, -1};
    if (!may_be_drawn(call, v, low, high)) return face;
    const int front = in_front(v, call.perspective), side = facing(v, call.perspective);
    if (side == 0 || (side < 0 && !call.two_sided)) return face;
    if (side < 0) {
        // The first packages append reversed copies after all faces. Ties are decided in the same order here: if a file
        // contains a face twice, once reversed, both have the same depth to the last bit.
        face.index = f + call.count;
        face.v[0] = v[2], face.v[2] = v[0];
    }
    for (int k = 0; k < 3; ++k) face.terms[k] = call.perspective ? 1.0f / face.v[k][2] : face.v[k][2];
    const float z0 = v[0][2], z1 = v[1][2], z2 = v[2][2];
    face.least = min(z0, min(z1, z2)) - 1.0e-6f * max(fabsf(z0), max(fabsf(z1), fabsf(z2)));
    face.front = front;
    return face;
}

// The depth at a pixel of a face across the camera's plane; 0 outside the face.
NR_NOINLINE float crossing_depth(const Drawing& call, const vec3* v, int i, int j) {
    const vec3d a = homogeneous_weights(v, pixel_centre(i, call.width), call.centre_of_row(j));
    return a[0] >= 0.0 && a[1] >= 0.0 && a[2] >= 0.0 ? (float)(1.0 / (a[0] + a[1] + a[2])) : 0.0f;
}

// The pixels of one row that a face may cover.
struct Span {
    int first, last;   // pixels
    int64 row;         // offset of the row's first pixel
    float y0, y1, y2;  // heights of the corners above the pixels' centres

    // Compute the depth at pixels with centres at x; returns which of them lie in the face.
    template <class F>
    NR_FUNC auto depth(const DrawnFace& face, bool perspective, F x, F& z) const {
        const float x0 = face.v[0][0], x1 = face.v[1][0], x2 = face.v[2][0];
        const F e0 = (x1 - x) * y2 - y1 * (x2 - x);
        const F e1 = (x2 - x) * y0 - y2 * (x0 - x);
        const F e2 = (x0 - x) * y1 - y0 * (x1 - x);
        const F whole = e0 + e1 + e2, mixed = e0 * face.terms[0] + e1 * face.terms[1] + e2 * face.terms[2];
        z = perspective ? whole / mixed : mixed / whole;
        return (e0 >= 0.0f) & (e1 >= 0.0f) & (e2 >= 0.0f);
    }
};

// Limit the pixels [first, last] of rows with centres at y to those between the face's edges, widened by the rounding
// error.
template <class F, class Ints>
NR_FUNC void limit_to_edges(const DrawnFace& face, int width, F y, Ints& first, Ints& last) {
    const F w = all<F>((float)width), left = to_floats(first), right = to_floats(last);
    F low = all<F>(-2.0f), high = all<F>(2.0f);
    for (int k = 0; k < 3; ++k) {
        const vec3 &a = face.v[(k + 1) % 3], &b = face.v[(k + 2) % 3];
        const float slope = a[1] - b[1], steep = fabsf(slope);
        if (!(steep > 1e-6f)) continue;
        const F p = a[0] * (b[1] - y), q = b[0] * (a[1] - y);
        const F at = (q - p) / slope, doubt = 1e-6f * (larger(p, -p) + larger(q, -q)) / steep;
        if (slope > 0.0f) low = larger(at - doubt, low);
        else high = smaller(at + doubt, high);
    }
    const F begin = 0.5f * (w * low + w - 1.0f) - 0.01f, end = 0.5f * (w * high + w - 1.0f) + 0.01f;
    first = to_ints(select(begin > left, smaller(begin, right), left - 1.0f)) + 1;
    last = to_ints(select(low <= high, larger(smaller(end, right), all<F>(-1.0f)), all<F>(-1.0f)));
}

// Call visit(span) for each row of a face's bounding box, with the pixels between its edges; F: rows that are computed
// together. Boxes no wider than a vector keep their width.
template <class F, class Visit>
NR_FUNC void for_each_span(const Drawing& call, int image, const DrawnFace& face, const Box& box, Visit visit) {
    typedef typename Lanes<F>::Ints Ints;
    constexpr int ROWS = Lanes<F>::WIDTH;
    for (int bottom = box.bottom; bottom <= box.top; bottom += ROWS) {
        const F y = call.centre_of_row(bottom + lane_numbers<Ints>());
        Ints first = all<Ints>(box.left), last = all<Ints>(box.right);
        if (ROWS == 1 || box.right - box.left >= ROWS) limit_to_edges(face, call.width, y, first, last);
        for (int n = 0; n < min(ROWS, box.top - bottom + 1); ++n) {
            const float at = lane_in_memory(y, n);
            visit(
                {lane_in_memory(first, n), lane_in_memory(last, n), call.row_start(image, bottom + n),
                 face.v[0][1] - at, face.v[1][1] - at, face.v[2][1] - at});
        }
    }
}

// Drawing on the CPU: the nearest face is visible; at equal depth, the one of lowest index.

template <class Start>
NR_FUNC void draw_pixel(const Drawing& call, const DrawnFace& face, bool inside, float z, int64 pixel) {
    float& nearest = call.nearest[pixel];
    int& shown = call.face_index[pixel];
    const bool wins = (z < nearest) | ((z == nearest) & (face.index < shown));
    if (inside & wins & (z > Start::template depth<float>(call, pixel))) nearest = z, shown = face.index;
}

#if NR_LANES
template <class Start>
inline void draw_eights(const Drawing& call, const DrawnFace& face, const Span& span) {
    const int width = call.width;
    const ints8 lane = lane_numbers<ints8>();
    for (int i = span.first; i <= span.last; i += 8) {
        const int at = i < width - 8 ? i : width - 8;
        const int64 pixel = span.row + at;
        __builtin_prefetch(call.nearest + pixel - ROWS_AHEAD * width);
        __builtin_prefetch(call.face_index + pixel - ROWS_AHEAD * width);
        if (!any(load<floats8>(call.nearest + pixel) >= face.least)) continue;  // nearer faces hide it
        floats8 z;
        const ints8 inside = span.depth(face, call.perspective, pixel_centre(at + lane, width), z);
        const ints8 deeper = z > Start::template depth<floats8>(call, pixel);
        // Only pixels in the row's span. Far from a thin face, rounding errors decide the signs of edge functions.
        const ints8 spanned = (lane >= span.first - at) & (lane <= span.last - at);
        // Positive floats have the order of their bits. A minimum is stored directly; a selection would be stored under
        // a mask, which takes far longer.
        const ints8 nearest = load<ints8>(call.nearest + pixel), shown = load<ints8>(call.face_index + pixel);
        const ints8 bits = select(inside & deeper & spanned, (ints8)z, all<ints8>(0x7fffffff));
        const ints8 wins = (bits < nearest) | ((bits == nearest) & (shown > face.index));
        store(call.nearest + pixel, smaller(bits, nearest));
        store(call.face_index + pixel, select(wins, all<ints8>(face.index), shown));
    }
}
#endif

template <class Start>
NR_FUNC void draw_box(const Drawing& call, int image, const DrawnFace& face, const Box& box) {
#if NR_LANES
    if (call.width >= 8) {
        for_each_span<floats8>(call, image, face, box, [&](const Span& span) { draw_eights<Start>(call, face, span); });
        return;
    }
#endif
    for_each_span<float>(call, image, face, box, [&](const Span& span) {
        for (int i = span.first; i <= span.last; ++i) {
            float z;
            const bool inside = span.depth(face, call.perspective, pixel_centre(i, call.width), z);
            draw_pixel<Start>(call, face, inside, z, span.row + i);
        }
    });
}

template <class Start>
NR_NOINLINE void draw_crossing(const Drawing& call, int image, const DrawnFace& face, const Box& box) {
    for (int j = box.bottom; j <= box.top; ++j)
        for (int i = box.left; i <= box.right; ++i)
            draw_pixel<Start>(call, face, true, crossing_depth(call, face.v, i, j), call.row_start(image, j) + i);
}

template <class Start>
NR_FUNC void draw_band_of_rows(const Drawing& call, int task) {
    const int image = task / call.bands, band = task % call.bands;
    const int bottom = (int)((int64)band * call.height / call.bands);
    const int top = (int)((int64)(band + 1) * call.height / call.bands) - 1;
    const int64 start = call.row_start(image, top), stop = call.row_start(image, bottom) + call.width;
    for (int64 i = start; i < stop; ++i) call.nearest[i] = call.far, call.face_index[i] = -1;
    const float low = call.centre_of_row(bottom), high = call.centre_of_row(top);
    for (int f = 0; f < call.count; ++f) {
        const vec3* v = call.corners(image, f);
        if (!may_be_drawn(call, v, low, high)) continue;
        Box box = pixel_box(v, !call.perspective || corners_behind(v) == 0, call);
        box.bottom = max(box.bottom, bottom), box.top = min(box.top, top);
        if (box.is_empty()) continue;
        const DrawnFace face = drawn_face(call, image, f, low, high);
        if (face.front == 0) draw_crossing<Start>(call, image, face, box);
        else if (face.front > 0) draw_box<Start>(call, image, face, box);
    }
    if (call.two_sided)
        for (int64 i = start; i < stop; ++i) call.face_index[i] -= call.face_index[i] < call.count ? 0 : call.count;
    if (call.visible)
        mark_faces(call.visible + (int64)image * (call.count + 1), call.count, call.face_index + start, stop - start);
}

// Drawing on CUDA.

// Most pixels of the bounding box of a small face; or of the face itself, where a row counts as some pixels.
constexpr int SMALL_BOX = 128, ROW_AS_PIXELS = 2;
// Most threads that share a row of a large face's bounding box.
constexpr int MOST_LANES = 32;

constexpr int64 NO_FACE = 0x7fffffffffffffff;  // key of a pixel without a face; greater than all others

template <class Start>
NR_FUNC void draw_key(const Drawing& call, const DrawnFace& face, bool inside, float z, int64 pixel) {
    if (!(inside && z > Start::template depth<float>(call, pixel) && z < call.far)) return;
    // Positive floats are ordered like their bits, so one minimum finds the nearest face of lowest index.
    const int64 key = ((int64)bits_of(z) << 32) | face.index;
    if (key < call.keys[pixel]) atomic_min(call.keys + pixel, key);
}

// Draw every ``lanes``-th pixel, starting at ``lane``, of the rows of a box.
template <class Start>
NR_FUNC void draw_part(const Drawing& call, int image, const DrawnFace& face, const Box& box, int lane, int lanes) {
    if (face.front == 0) {
        for (int j = box.bottom; j <= box.top; ++j)
            for (int i = box.left + lane; i <= box.right; i += lanes)
                draw_key<Start>(call, face, true, crossing_depth(call, face.v, i, j), call.row_start(image, j) + i);
        return;
    }
    for_each_span<float>(call, image, face, box, [&](const Span& span) {
        for (int i = span.first + lane; i <= span.last; i += lanes) {
            float z;
            const bool inside = span.depth(face, call.perspective, pixel_centre(i, call.width), z);
            draw_key<Start>(call, face, inside, z, span.row + i);
        }
    });
}

// The number of threads that share a row of a box, so that each has a few pixels at most.
NR_FUNC int lanes_of(const Box& box) {
    int lanes = MOST_LANES;
    while (lanes > 1 && 4 * lanes > box.right - box.left + 1) lanes /= 2;
    return lanes;
}

// Whether a face covers few pixels of a large bounding box.
NR_FUNC bool is_thin(const Drawing& call, const DrawnFace& face, int rows) {
    if (face.front != 1) return false;
    const vec3 s = face.v[1] - face.v[0], t = face.v[2] - face.v[0];
    const float pixels = fabsf(s[0] * t[1] - s[1] * t[0]) * (float)call.width * (float)call.whole_height() / 8.0f;
    return pixels + (float)(ROW_AS_PIXELS * rows) <= (float)SMALL_BOX;
}

// Draw one small face, or append a large one to the queue.
template <class Start>
NR_FUNC void draw_or_queue(const Drawing& call, int task) {
    const int image = task / call.count;
    const DrawnFace face = drawn_face(call, image, task % call.count, -1.0f, 1.0f);
    if (face.front < 0) return;
    const Box box = pixel_box(face.v, face.front, call);
    if (box.is_empty()) return;
    const int columns = box.right - box.left + 1, rows = box.top - box.bottom + 1;
    if (columns * rows <= SMALL_BOX || is_thin(call, face, rows)) draw_part<Start>(call, image, face, box, 0, 1);
    else call.queue.put(task, rows * lanes_of(box));
}

// Draw some pixels of a row of a large face from the queue; repeat until the queue is empty.
template <class Start>
NR_FUNC void draw_from_queue(const Drawing& call, int task) {
    const int64 end = call.queue.thread_count();
    for (int64 thread = task; thread < end; thread += call.queue.threads) {
        int64 number, index;
        call.queue.find(thread, number, index);
        const int image = (int)(number / call.count);
        const DrawnFace face = drawn_face(call, image, (int)(number % call.count), -1.0f, 1.0f);
        const Box box = pixel_box(face.v, face.front, call);
        const int lanes = lanes_of(box), row = box.bottom + (int)index / lanes;
        draw_part<Start>(call, image, face, {box.left, box.right, row, row}, (int)index % lanes, lanes);
    }
}

// Convert the minimum keys of the pixels of a task to face indices, and mark these faces as visible.
NR_FUNC void decode_keys(const Drawing& call, int task) {
    const Pixels pixels = pixels_of_task(task, call.each, call.images * call.height, call.width);
    const int64 start = (int64)pixels.first * call.width + pixels.left;
    const int64 stop = (int64)(pixels.last - 1) * call.width + pixels.right;
    for (int64 i = start; i < stop; ++i) {
        const int index = (int)call.keys[i];
        const int f = call.keys[i] == NO_FACE ? -1 : index < call.count ? index : index - call.count;
        call.face_index[i] = f;
        if (!call.visible) continue;
        int* mask = call.visible + i / ((int64)call.height * call.width) * (call.count + 1);
        store_relaxed(mask + (f < 0 ? call.count : f), 1);
    }
}

// Kernels.

NR_FUNC void draw_band(const Drawing& call, int task) { draw_band_of_rows<BehindNearPlane>(call, task); }
NR_FUNC void draw_or_queue_face(const Drawing& call, int task) { draw_or_queue<BehindNearPlane>(call, task); }
NR_FUNC void draw_queued_faces(const Drawing& call, int task) { draw_from_queue<BehindNearPlane>(call, task); }

NR_FUNC void peel_band(const Drawing& call, int task) { draw_band_of_rows<BehindLayer>(call, task); }
NR_FUNC void peel_or_queue_face(const Drawing& call, int task) { draw_or_queue<BehindLayer>(call, task); }
NR_FUNC void peel_queued_faces(const Drawing& call, int task) { draw_from_queue<BehindLayer>(call, task); }

}  // namespace nr
