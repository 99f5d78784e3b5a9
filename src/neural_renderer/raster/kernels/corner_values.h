// Known colours of outlines and seams: values that faces interpolate from their corners, such as depth, normals,
// positions and texture coordinates. At a crossing they are those of the edge's ends, perspective-correct, so that no
// pixel needs to show the face, and colours that curve within a pixel are right.
#pragma once

#include "crossings.h"

namespace nr {

// Most faces on one side of a seam, of which one is to be visible.
constexpr int LONGEST_SIGHT = 3;

// The known values of a face where one of its edges crosses a scan line.
struct EdgeValues {
    const float *p, *q;  // values of the edge's ends; channel 0 of the image is at 0
    float of_p, of_q;    // their weights

    NR_FUNC EdgeValues(const Lines& lines, const BoundaryEdge& edge, const Crossing& at)
        : EdgeValues(lines, edge, at, edge.face, edge.p, edge.q) {}
    // The values of another face with the same ends, which are its corners p and q.
    NR_FUNC EdgeValues(const Lines& lines, const BoundaryEdge& edge, const Crossing& at, int face, int p, int q)
        : p(lines.known_value(face, p)), q(lines.known_value(face, q)) {
        // Values over depth are linear on the screen.
        of_p = lines.perspective ? (1.0f - at.share) * edge.qz : 1.0f - at.share;
        of_q = lines.perspective ? at.share * edge.pz : at.share;
        const float sum = of_p + of_q;
        of_p /= sum, of_q /= sum;
    }
    NR_FUNC float of(int channel) const { return of_p * p[channel] + of_q * q[channel]; }
};

// The faces of the surface along a scan line on one side of a seam, up to a pixel from the crossing.
struct Sight {
    float reach = 0.0f;  // length in pixels
    bool shown = false;  // whether one of the faces is visible at ``pixel``, the first centre on this side

    NR_FUNC Sight(const Lines& lines, int f, const Crossing& at, int pixel, int step) {
        const int visible = lines.face(at.u, pixel);
        if (f == visible && f == lines.face(at.u, pixel + step)) {  // it holds two centres, a pixel apart
            reach = 1.0f, shown = true;
            return;
        }
        float exit = at.v;
        for (int n = 0; n < LONGEST_SIGHT && f >= 0 && reach < 1.0f; ++n) {
            shown |= f == visible;
            int through;
            exit = lines.exit(f, at.u, exit, through);
            reach = min(fabsf(exit - at.v), 1.0f);
            f = through < 0 ? -1 : lines.adjacent[(int64)f * 3 + through];
        }
    }
};

// Pass the gain of known values at a seam to the sink. A centre hits a side with a probability equal to its reach, so
// the number of sides that are visible, over the sum of their reaches, has the mean 1; half of it remains where
// something else hides one side, as in the mean over shifts half of a pixel beside an outline.
template <class Sink>
NR_FUNC void gain_of_known_seam(const Lines& lines, const BoundaryEdge& edge, const Crossing& at, Sink& sink) {
    const Sight own(lines, edge.face, at, at.inner, -edge.outward);
    const Sight other(lines, edge.adjacent, at, at.outer, edge.outward);
    if (!(own.shown || other.shown)) return;
    const float reach = own.reach + other.reach;
    const float weight = (float)(own.shown + other.shown) / max(reach, LEAST_CHORD);
    const EdgeValues inside(lines, edge, at), outside(lines, edge, at, edge.adjacent, edge.adjacent_p, edge.adjacent_q);
    const EdgePixels pixels(lines, at, reach < 2.0f);
    for (int c = 0; c < lines.channels; ++c) sink(c, pixels, weight * (inside.of(c) - outside.of(c)));
}

}  // namespace nr
