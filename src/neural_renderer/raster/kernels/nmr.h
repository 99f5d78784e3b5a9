// The paper's approximate gradient of rasterisation: Kato, Ushiku and Harada, "Neural 3D Mesh Renderer", CVPR 2018,
// sections 3.2 and 3.3, in their order.
//
// In the paper, a corner v_i of a face moves along x from x_0 to x_1, where an edge of the face reaches the centre of
// pixel P_j, whose colour then changes by delta^I_j. The paper replaces this jump by a ramp, of the slope
// delta^I_j / delta^x_i with delta^x_i = x_1 - x_0, and keeps the slope only if the change lowers the loss, whose
// gradient at the pixel is delta^P_j:
//
//     (1)  dI_j/dx_i   = delta^I_j / delta^x_i    if delta^P_j delta^I_j < 0, else 0     for pixels outside the face
//     (2)  dI_j/dx_i   = dI_j/dx_i|a + dI_j/dx_i|b                                       for pixels inside
//     (3)  dI_j/dx_i|a = delta^I^a_j / delta^a_x  if delta^P_j delta^I^a_j < 0, else 0   for the edge on one side
//     (4)  dI_j/dx_i|b = delta^I^b_j / delta^b_x  if delta^P_j delta^I^b_j < 0, else 0   for the edge on the other side
//
// The kernel visits each edge with all pixels of a scan line: rows for x, columns for y ("swapping the axes"). The edge
// moves over the pixels outside (1) or uncovers those inside (3); the opposite edge, visited separately, gives (4). The
// sum over j of delta^P_j dI_j/dx_i is the gradient of the corner.
#pragma once

#include "lanes.h"
#include "queue.h"
#include "scan_lines.h"
#include "tasks.h"

namespace nr {

// Added to divisors: the share of a corner may be 0 where a pixel lies on the edge.
constexpr float TINY = 1.0e-15f;
// Zero padding before each stored line and after the last, one SIMD vector wide.
constexpr int PADDING = 16;
// Pixels inside the face, on one line, up to which single floats are faster than a vector.
constexpr int FEW = 8;
// Most scan lines of a CUDA thread, and neighbouring threads that share a line, so that they read one memory sector.
constexpr int MOST_LINES = 4, LINE_LANES = 8;

// Rows and columns stored line by line, so that the pixels of each are contiguous. Plane 0 holds the sum over channels
// of value times gradient, the other planes the gradients of the first channels. A silhouette has one plane, the gains:
// the decrease of the loss if covering the pixel lowers it, minus the decrease if uncovering it does.
struct ScanLines {
    float* rows;     // [images, height, planes, PADDING + width]
    float* columns;  // [images, width, planes, PADDING + height]
    // (length - first, last + 1) of each line, [images, height + width], where first and last are the outermost pixels
    // with a gradient.
    vec2i* spans;
    int planes;

    NR_FUNC static int64 plane(const ScanAxis& lines) { return PADDING + lines.length; }
    // The first pixel of line u.
    NR_FUNC float* line(const ScanAxis& lines, int image, int u) const {
        return (lines.axis ? columns : rows) + ((int64)image * lines.count + u) * planes * plane(lines) + PADDING;
    }
    NR_FUNC vec2i* span(const ScanAxis& lines, int image, int u) const {
        const int before = lines.axis ? lines.length : 0;  // rows
        return spans + (int64)image * (lines.count + lines.length) + before + u;
    }
};

struct NmrBackward {
    Scene scene;
    const float* image;  // [images, channels, height, width]; null for the silhouette
    int channels;        // channels of the image
    ScanLines lines;
    const int* visible;  // mask of visible faces, [images, count + 1]; on the CPU
    Queue queue;         // visible faces; on CUDA
    float eps;           // added to every distance, in screen units
    vec3* to_faces;      // gradient to the corners, [images, count, 3], 0 before
};

// ---- Section 3.2: one edge, one scan line ----

// How far the corners p and q travel until the edge reaches a pixel at a distance on the line: p travels
// reach * distance / share_p in screen units, q by the same formula. The gradient of p is gain / (travel + eps), here
// with numerator and denominator multiplied by share_p, which is 0 for a line through q, moved only by q.
struct Travel {
    float reach, slack_p, slack_q;
};

// Sums over pixels, for both corners of an edge.
template <class F>
struct EndSums {
    F p, q;
};

// Equations 1, 3 and 4: the ramp of each pixel, where ``gain`` is -delta^P_j delta^I_j, the decrease of the loss.
template <class F>
NR_FUNC void add_ramps(const Travel& travel, F gain, F distance, EndSums<F>& sums) {
    NR_FUSED
    const F travel_p = travel.reach * distance + travel.slack_p, travel_q = travel.reach * distance + travel.slack_q;
    const F ramp = quotient(select(gain > 0.0f, gain, all<F>(0.0f)), travel_p * travel_q);
    sums.p += ramp * travel_q, sums.q += ramp * travel_p;
}

// The colour that pixels of a scan line would take: that of the pixel across the edge.
struct NewColor {
    int channels;        // channels with a gradient; 0 for a silhouette
    const float* first;  // value of the first channel
    int64 area;          // stride from channel to channel
    float red, green, blue;

    NR_FUNC NewColor(int channels, const float* first, int64 area)
        : channels(channels),
          first(first),
          area(area),
          red(channels < 1 ? 0.0f : first[0]),
          green(channels < 3 ? 0.0f : first[area]),
          blue(channels < 3 ? 0.0f : first[2 * area]) {}

    // The sum over channels of the new colour times the gradients of stored pixels, starting at ``grad`` with the
    // stride ``plane``. The usual three channels are unrolled, so that their colours stay in registers.
    template <class F>
    NR_FUNC F loss(const float* grad, int64 plane) const {
        NR_FUSED
        F lost = red * load<F>(grad);
        if (channels >= 3) {
            lost += green * load<F>(grad + plane);
            lost += blue * load<F>(grad + 2 * plane);
        }
        for (int c = channels < 3 ? 1 : 3; c < channels; ++c) lost += first[c * area] * load<F>(grad + c * plane);
        return lost;
    }
};

// A run of ``count`` pixels of a stored line, from ``begin`` on, in ``direction`` 1 or -1; the first lies ``distance``
// pixels from the edge.
struct Run {
    const float* stored;
    int64 plane;
    int begin, direction, count;
    float distance;
    int lane, lanes;  // neighbouring CUDA threads process neighbouring pixels
};

// Sum the pixels n of a run for which here(n) is true; ``sign`` multiplies stored gains. Values stored after the run
// are 0 or masked.
template <class F, class Here>
NR_FUNC EndSums<F> sum_of_run(const Run& run, const NewColor& color, const Travel& travel, float sign, Here here) {
    NR_FUSED
    constexpr int WIDTH = Lanes<F>::WIDTH;
    const F ahead = to_floats(lane_numbers<typename Lanes<F>::Ints>());
    const F start = run.distance + (run.direction > 0 ? ahead : (float)(WIDTH - 1) - ahead);
    EndSums<F> sums = {all<F>(0.0f), all<F>(0.0f)};
    const float* at = run.stored + run.begin - (run.direction > 0 ? 0 : WIDTH - 1) + run.direction * run.lane;
    for (int n = run.lane; n < run.count; n += WIDTH * run.lanes, at += run.direction * WIDTH * run.lanes) {
        const auto mask = mask_of<F>([&](int k) { return here(run.direction > 0 ? n + k : n + WIDTH - 1 - k); });
        if (!any(mask)) continue;
        const F gain = color.channels > 0 ? load<F>(at) - color.loss<F>(at + run.plane, run.plane) : sign * load<F>(at);
        add_ramps(travel, select(mask, gain, all<F>(0.0f)), start + (float)n, sums);
    }
    return sums;
}

// Add the sums over a line to those of the edge, multiplied by the share of each corner.
template <class F>
NR_FUNC void add_shares(const EndSums<F>& sums, float share_p, float share_q, EndSums<F>& total) {
    NR_FUSED
    total.p += share_p * sums.p, total.q += share_q * sums.q;
}

// A moving edge p -> q of a counter-clockwise face with third corner r.
struct MovingEdge : LineEdge {
    int count, length;  // number and length of the lines
    bool placed;        // an edge with an end behind the camera gets no gradient, because this end has no projection
    bool bounded;       // whether r is in front of the camera

    NR_FUNC MovingEdge(const ScanAxis& lines, const vec3& p, const vec3& q, const vec3& r)
        : LineEdge(lines, p, q, r),
          count(lines.count),
          length(lines.length),
          placed(!(!has_slope() || p[2] <= 0.0f || q[2] <= 0.0f)),
          bounded(!(r[2] <= 0.0f)) {}

    NR_FUNC int first_line() const { return (int)ceilf(clamp(pu < qu ? pu : qu, 0.0f, (float)count)); }
    NR_FUNC int last_line() const { return (int)floorf(clamp(pu < qu ? qu : pu, -1.0f, (float)(count - 1))); }
    // Computed from the nearer end, so that it is exact at both ends.
    NR_FUNC float crossing(int u) const {
        const float from_p = (float)u - pu, from_q = (float)u - qu;
        const float c = fabsf(from_p) < fabsf(from_q) ? pv + slope * from_p : qv + slope * from_q;
        return clamp(c, -2.0f, (float)length + 1.0f);
    }
    // The last pixel before a line leaves the face through p-r or q-r; the image's last if r is behind the camera.
    NR_FUNC int far_side(int line) const {
        const float u = (float)line;
        float limit = rv;
        if (!bounded) limit = outward > 0 ? 0.0f : (float)length;
        else if ((pu < u && u < ru) || (ru < u && u < pu)) limit = pv + (rv - pv) * (u - pu) / (ru - pu);
        else if (qu != ru) limit = qv + (rv - qv) * (u - qu) / (ru - qu);
        limit = clamp(limit, 0.0f, (float)(length - 1));
        return (int)(outward > 0 ? ceilf(limit) : floorf(limit));
    }
};

// The gradient of one edge to p and q, from the lines and pixels of a task.
struct EdgeGradient {
    const NmrBackward& call;
    const LineTask& task;
    const ScanAxis lines;
    const MovingEdge edge;
    EndSums<wide_floats> by_many;
    EndSums<float> one_by_one;

    NR_FUNC EdgeGradient(
        const NmrBackward& call, const LineTask& task, int axis, const vec3& p, const vec3& q, const vec3& r)
        : call(call),
          task(task),
          lines(axis, call.scene.height, call.scene.width),
          edge(lines, p, q, r),
          by_many{all<wide_floats>(0.0f), all<wide_floats>(0.0f)},
          one_by_one{0.0f, 0.0f} {
        if (!edge.placed) return;
        for (int u = edge.first_line() + task.part, last = edge.last_line(); u <= last; u += task.parts) add_line(u);
    }

    NR_FUNC void add_line(int u) {
        const float c = edge.crossing(u);
        const int outward = edge.outward, inner = (int)(outward > 0 ? floorf(c) : ceilf(c)), outer = inner + outward;
        // The border of the image: a crossing counts only between two pixel centres.
        if (min(inner, outer) < 0 || max(inner, outer) >= lines.length) return;
        const int64 area = call.scene.area(), inside = lines.pixel(u, inner), outside = lines.pixel(u, outer);
        const int* shown = call.scene.face_index + task.image * area;
        const bool binary = !call.image;
        // Section 3.3: no gradient flows where the crossing is occluded, so the inner pixel must show this face. Pixels
        // inside a silhouette change only if the outer pixel shows the background.
        const bool covers = shown[inside] == task.face, uncovers = !(binary && shown[outside] >= 0);
        if (!covers && !uncovers) return;
        const float share_p = fabsf(edge.qu - (float)u), share_q = fabsf((float)u - edge.pu);
        const Travel travel = {
            fabsf(edge.qu - edge.pu) * 2.0f / (float)lines.length, call.eps * share_p + TINY,
            call.eps * share_q + TINY};
        const float to_p = -(float)outward * share_p, to_q = -(float)outward * share_q;
        const float* colors = binary ? nullptr : call.image + task.image * call.channels * area;
        const int channels = call.lines.planes - 1;
        Run run = {call.lines.line(lines, task.image, u), ScanLines::plane(lines), 0, outward, 0, 0.0f, 0, 1};
        if (THREADS_ARE_LANES) run.lane = task.lane, run.lanes = task.lanes;
        if (covers) {  // equation 1: from the edge outward, to the end of the line's span
            const vec2i span = *call.lines.span(lines, task.image, u);
            const int low = lines.length - span[0], high = span[1] - 1;
            run.begin = outward > 0 ? max(low, outer) : min(high, outer);
            run.count = outward > 0 ? high - run.begin + 1 : run.begin - low + 1;
            run.distance = fabsf((float)run.begin - c);
            if (run.count > 0) {
                const auto always = [](int) { return true; };
                const NewColor color(channels, binary ? nullptr : colors + inside, area);
                add_shares(sum_of_run<wide_floats>(run, color, travel, 1.0f, always), to_p, to_q, by_many);
            }
        }
        if (uncovers) {  // equations 2 to 4: from the edge inward, over the pixels that show the face
            run.begin = inner, run.direction = -outward;
            run.count = (inner - edge.far_side(u)) * outward + 1;
            run.distance = fabsf((float)inner - c);
            const int* first_inside = shown + inside;
            const int64 step = -outward * lines.along;
            const int count = run.count, f = task.face;
            const auto shows = [=](int n) { return n < count && first_inside[n * step] == f; };
            const NewColor color(channels, binary ? nullptr : colors + outside, area);
            if (run.count > 0 && (THREADS_ARE_LANES || run.count <= FEW))
                add_shares(sum_of_run<float>(run, color, travel, -1.0f, shows), -to_p, -to_q, one_by_one);
            else if (run.count > 0)
                add_shares(sum_of_run<wide_floats>(run, color, travel, -1.0f, shows), -to_p, -to_q, by_many);
        }
    }
    NR_FUNC float of_p() const { return sum(by_many.p) + one_by_one.p; }
    NR_FUNC float of_q() const { return sum(by_many.q) + one_by_one.q; }
};

// ---- Section 3.3: the faces of an image ----

// Process the edges of one face over the pixels and scan lines of a task.
NR_NOINLINE void move_edges_of_face(const NmrBackward& call, const LineTask& task) {
    const vec3* v = call.scene.corners(task.image, task.face);
    const bool clockwise = facing(v, 1) < 0;
    vec3 to[3] = {};
    for (int k = 0; k < 3; ++k) {
        // Counter-clockwise: corners 0, 1, 2, or 2, 1, 0.
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        const int p = clockwise ? 2 - k : k, q = clockwise ? 2 - m : m, r = clockwise ? 2 - n : n;
        for (int axis = 0; axis < 2; ++axis) {
            const EdgeGradient edge(call, task, axis, v[p], v[q], v[r]);
            to[p][axis] += edge.of_p(), to[q][axis] += edge.of_q();
        }
    }
    vec3* corners = call.to_faces + ((int64)task.image * call.scene.count + task.face) * 3;
    for (int k = 0; k < 3; ++k) {
        if (call.queue.threads == 0) corners[k] = to[k];
        else atomic_add_nonzero(corners + k, to[k]);
    }
}

// Process one visible face of one image; on CUDA, entries of the queue.
NR_FUNC void nmr_backward(const NmrBackward& call, int task) {
    const Scene& scene = call.scene;
    if (call.queue.threads == 0
        && call.visible[task / scene.count * (int64)(scene.count + 1) + task % scene.count] == 0)
        return;
    for_each_line_task(
        call.queue, scene, task, LINE_LANES, MOST_LINES, [&](const LineTask& line) { move_edges_of_face(call, line); });
}

// ---- How scan lines are stored ----

struct StoreLines {
    Scene scene;
    const float* image;  // [images, channels, height, width]; null for the silhouette
    // Gradient to the image, [images, channels, height, width]; or, if ``halved``, to the means of its blocks of 2 x 2
    // pixels, [images, channels, height / 2, width / 2]; a pixel gets a quarter of the gradient of its block.
    const float* grad;
    int channels, halved;
    ScanLines lines;
    int each;       // rows of a task, on CUDA
    float* spread;  // gradient of each pixel, where ``halved``, [images, channels, height, width]; or null. On CUDA
    int* queued;    // 1 for faces in the queue, [images, count], 0 before; null without a queue. On CUDA
    Queue queue;    // gets the visible faces
};

// The gain of a pixel of a silhouette; ``decrease`` is that of the loss per unit of brightness.
NR_FUNC float silhouette_gain(float decrease, int face) {
    const float covered = face >= 0 ? 1.0f : 0.0f;
    return decrease > 0.0f ? decrease * (1.0f - covered) : decrease * covered;
}

// On the CPU: stores ``count`` neighbouring lines of one axis, starting at ``first``; several columns share cache
// lines.
template <int AXIS>
struct LineWriter {
    const StoreLines& call;
    const ScanAxis lines;
    const int image, first, count, width;
    const int64 area, pixel;  // ``pixel``: offset of the first pixel of the first line in the image
    const int64 plane, next;  // strides from plane to plane and from line to line
    float* stored;            // the first pixel of the first line

    LineWriter(const StoreLines& call, int image, int first, int count)
        : call(call),
          lines(AXIS, call.scene.height, call.scene.width),
          image(image),
          first(first),
          count(count),
          width(call.scene.width),
          area(call.scene.area()),
          pixel(lines.pixel(first, 0)),
          plane(ScanLines::plane(lines)),
          next(call.lines.planes * plane),
          stored(call.lines.line(lines, image, first)) {}

    // Call visit(from, to) for each pixel: its offsets in the image and among the stored pixels.
    template <class Visit>
    void each_pixel(Visit visit) const {
        if constexpr (AXIS == 0)
            for (int v = 0; v < lines.length; ++v) visit(v, v);
        else
            for (int v = 0; v < lines.length; ++v)
                for (int64 k = 0; k < count; ++k) visit(k - (int64)v * width, v + k * next);
    }
    // Call visit(block, from, to) for each horizontal pair of pixels of a 2 x 2 block.
    template <class Visit>
    void each_pair(Visit visit) const {
        if constexpr (AXIS == 0)
            for (int block = 0; 2 * block < lines.length; ++block) visit(block, 2 * block, 2 * block);
        else
            for (int v = 0; v < lines.length; ++v)
                for (int64 k = 0; k < count; k += 2)
                    visit(k / 2 - (int64)(v / 2) * (width / 2), k - (int64)v * width, v + k * next);
    }

    void write() const {
        const int planes = call.lines.planes;
        for (int k = 0; k < count * planes; ++k)
            for (int i = 1; i <= PADDING; ++i) stored[k * plane - i] = 0.0f;
        if (planes == 1) write_gains();
        else write_colors();
        for (int k = 0; k < count; ++k) *call.lines.span(lines, image, first + k) = span(stored + k * next);
    }
    void write_gains() const {
        const int* shown = call.scene.face_index + image * area + pixel;
        float* to = stored;
        if (call.halved) {
            const int64 block = pixel / width / 2 * (width / 2) + pixel % width / 2;
            const float* grad = call.grad + image * (area / 4) + block;
            const int64 apart = AXIS == 0 ? 1 : next;
            each_pair([=](int64 block, int64 from, int64 at) {
                const float decrease = -0.25f * grad[block];
                to[at] = silhouette_gain(decrease, shown[from]);
                to[at + apart] = silhouette_gain(decrease, shown[from + 1]);
            });
        } else {
            const float* grad = call.grad + image * area + pixel;
            each_pixel([=](int64 from, int64 at) { to[at] = silhouette_gain(-grad[from], shown[from]); });
        }
    }
    // Sums in the order of `NewColor::loss`, so that a pixel that already has the new colour gains exactly 0.
    void write_colors() const {
        const float* value = call.image + image * call.channels * area + pixel;
        const float* grad = call.grad + image * call.channels * area + pixel;
        float* to = stored;
        const int64 area = this->area, plane = this->plane;
        if (call.lines.planes == 4) {  // the usual three channels together
            const float *green = value + area, *blue = green + area, *by_green = grad + area,
                        *by_blue = by_green + area;
            float *to_red = to + plane, *to_green = to_red + plane, *to_blue = to_green + plane;
            each_pixel([=](int64 from, int64 at) {
                NR_FUSED
                float sum = value[from] * grad[from];
                sum += green[from] * by_green[from];
                sum += blue[from] * by_blue[from];
                to[at] = sum;
                to_red[at] = grad[from], to_green[at] = by_green[from], to_blue[at] = by_blue[from];
            });
            return;
        }
        each_pixel([=](int64, int64 at) { to[at] = 0.0f; });
        for (int c = 0; c < call.lines.planes - 1; ++c, value += area, grad += area) {
            float* grads = to + (c + 1) * plane;
            each_pixel([=](int64 from, int64 at) {
                NR_FUSED
                to[at] += value[from] * grad[from];
                grads[at] = grad[from];
            });
        }
    }
    vec2i span(const float* line) const {
        const bool gains = call.lines.planes == 1;
        const auto has_gradient = [gains](float value) { return gains ? value > 0.0f : value != 0.0f; };
        int low = lines.length, high = -1;
        for (int c = gains ? 0 : 1; c < call.lines.planes; ++c) {
            const float* values = line + c * plane;
            for (int v = 0; v < low; ++v)
                if (has_gradient(values[v])) low = v;
            for (int v = lines.length - 1; v > high; --v)
                if (has_gradient(values[v])) high = v;
        }
        return {lines.length - low, high + 1};
    }
};

// A task has PADDING neighbouring rows or columns, whose pixels share cache lines.
NR_FUNC void store_lines(const StoreLines& call, int task) {
    const int height = call.scene.height, width = call.scene.width;
    const int row_tasks = (height + PADDING - 1) / PADDING, tasks = row_tasks + (width + PADDING - 1) / PADDING;
    const int image = task / tasks, group = task % tasks;
    if (group >= row_tasks) {
        const int first = (group - row_tasks) * PADDING;
        return LineWriter<1>(call, image, first, min(PADDING, width - first)).write();
    }
    for (int u = group * PADDING; u < min((group + 1) * PADDING, height); ++u) LineWriter<0>(call, image, u, 1).write();
}

// CUDA stores pixel by pixel and does not write the padding.
NR_FUNC void store_pixel(const StoreLines& call, int image, int row, int i) {
    const int height = call.scene.height, width = call.scene.width, j = height - 1 - row;
    const ScanAxis across(0, height, width), down(1, height, width);
    const int64 area = call.scene.area(), pixel = image * call.channels * area + (int64)row * width + i;
    const int half = call.halved ? 2 : 1;
    const int64 block = ((int64)image * call.channels * (height / half) + row / half) * (width / half) + i / half;
    const float *value = call.image ? call.image + pixel : nullptr, *grad = call.grad + block;
    const float share = 1.0f / (float)(half * half);
    float *in_row = call.lines.line(across, image, j) + i, *in_column = call.lines.line(down, image, i) + j;
    float sum = 0.0f;
    bool has_gradient = false;
    if (!call.image) {
        sum = silhouette_gain(-share * grad[0], call.scene.face_index[image * area + (int64)row * width + i]);
        has_gradient = sum > 0.0f;
    } else
        for (int c = 0; c < call.channels; ++c, value += area, grad += area / (half * half)) {
            const float by = share * grad[0];
            if (call.spread) call.spread[pixel + c * area] = by;
            sum += value[0] * by;  // the sum of `LineWriter`
            in_row[(c + 1) * ScanLines::plane(across)] = in_column[(c + 1) * ScanLines::plane(down)] = by;
            has_gradient |= by != 0.0f;
        }
    in_row[0] = in_column[0] = sum;
    if (!has_gradient) return;
    vec2i &of_row = *call.lines.span(across, image, j), &of_column = *call.lines.span(down, image, i);
    atomic_max(&of_row[0], width - i), atomic_max(&of_row[1], i + 1);
    atomic_max(&of_column[0], height - j), atomic_max(&of_column[1], j + 1);
}

// The pixels of a task; spans are 0 before. The first thread that finds a face appends it to the queue.
NR_FUNC void store_pixels(const StoreLines& call, int task) {
    const Scene& scene = call.scene;
    const Pixels pixels = pixels_of_task(task, call.each, scene.images * scene.height, scene.width);
    for (int row = pixels.first; row < pixels.last; ++row)
        for (int i = pixels.left; i < pixels.right; ++i) {
            const int image = row / scene.height, f = scene.face_index[(int64)row * scene.width + i];
            store_pixel(call, image, row % scene.height, i);
            if (!call.queued || f < 0) continue;
            int* const queued = call.queued + (int64)image * scene.count + f;
            if (*queued == 0 && atomic_cas(queued, 0, 1) == 0)  // the first condition excludes most pixels
                put_lines(call.queue, scene, image, f, LINE_LANES, MOST_LINES);
        }
}

}  // namespace nr
