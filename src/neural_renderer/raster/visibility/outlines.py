"""Outlines: edges of a face with the background or a farther face across them.

The chord of a face is the length of a scan line inside the face. If it is shorter than a pixel, a pixel centre hits it
with a probability equal to its length, so the crossing is weighted by the inverse. If the surface continues behind the
chord, a centre in the adjacent face (the stand-in) shows the outline as well, and the chord runs through both faces.

``OUTLINES`` declares a C++ struct for native functions, after `CROSSINGS`, `GAINS` and `NEARNESS`.
"""

OUTLINES = """
struct Outline {
    // Whether the face at the outer pixel passes in front of the crossing, and so hides or cuts the edge.
    static CUDA_CALLABLE bool is_behind(const Lines& lines, const Edge& edge, const Crossing& at) {
        float x = (2.0f * at.v + 1.0f - (float)lines.length) / (float)lines.length;
        float y = (2.0f * (float)at.u + 1.0f - (float)lines.count) / (float)lines.count;
        if (lines.axis == 1) {
            const float other = x;
            x = y, y = other;
        }
        const int perspective = lines.perspective;
        const float own = (1.0f - at.share) * Nearness::of(edge.pz, perspective)
            + at.share * Nearness::of(edge.qz, perspective);
        return Nearness::of_plane(lines.faces + (wp::int64)at.outer_face * 3, x, y, perspective) >= own;
    }

    // The gain at a crossing with the background or a farther face outside; else 0.
    static CUDA_CALLABLE float gain(const Lines& lines, const Edge& edge, const Crossing& at) {
        if (at.inner_face < 0) return 0.0f;
        const float u = (float)at.u;
        float own = 1.0f, joint = 1.0f;  // chords from the crossing on: of the face, and of both
        int stand_in = -1;  // or the adjacent face behind a chord shorter than a pixel
        if (!lines.perspective || edge.rz > 0.0f) {  // otherwise the third corner is behind the camera
            const bool through_pr = (edge.pu <= u) != (edge.ru <= u);
            float exit = edge.rv;
            if (through_pr) exit = edge.pv + (edge.rv - edge.pv) * (u - edge.pu) / (edge.ru - edge.pu);
            else if (edge.qu != edge.ru) exit = edge.qv + (edge.rv - edge.qv) * (u - edge.qu) / (edge.ru - edge.qu);
            own = joint = wp::min(fabsf(exit - at.v), 1.0f);
            if (own < 1.0f) stand_in = through_pr ? edge.adjacent_pr : edge.adjacent_qr;
            if (stand_in >= 0) joint = lines.chord(stand_in, at.u, exit, at.v);
        }
        if (at.inner_face != edge.face && at.inner_face != stand_in) return 0.0f;
        if (at.outer_face >= 0 && is_behind(lines, edge, at)) return 0.0f;
        const float weight = Lines::weight(joint);
        Gain gain;
        gain.set(lines, edge, at);
        gain.inside.extrapolate(weight, at.offset, gain.before_is_inside);
        gain.outside.extrapolate(weight, 1.0f - at.offset, gain.behind_is_outside);
        if (stand_in >= 0 && gain.before_face == stand_in && at.inner_face == edge.face) {
            // The stand-in's colour, plus the face's difference from it. The difference has the larger weight of the
            // face alone, which centres hit less often.
            gain.inside.near_weight = Lines::weight(own);
            gain.inside.next_weight = weight - gain.inside.near_weight;
        }
        return gain.sum(lines, at, weight > 1.0f);
    }
};
"""
