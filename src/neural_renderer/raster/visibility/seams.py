"""Seams: edges between two visible faces of one surface, across which the colour may jump.

The gradient at a seam needs the colours of both faces, from pixels that show them. The pixels beside the seam may miss
a narrow face. Then the pixel at the middle of the face is used.

If a face is small, no pixel may show it, so the two sides are estimated independently (Horvitz and Thompson, 1952): a
side counts only if its pixel shows its face, with the inverse of the probability of that, its chord. A colour that is
subtracted from both sides leaves their difference as it is, so the mean colour of other faces nearby is subtracted
first. This removes most of the noise.

To search the next scan lines, too, for pixels that show the face was tried: the noise at triangles of two pixels falls
from 0.8 to 0.45 of the gradient, but the estimate takes 1.4 to 1.6 times as long.

``SEAMS`` declares a C++ struct for native functions, after `CROSSINGS` and `GAINS`.
"""

from ..warp.point import fill

# Largest area of a small face, in pixels. Measured: below it the middle of a face is rarely visible; above it, the
# middle gives less noise.
SMALL = 1.5

_SEAMS = """
struct Seam {
    static CUDA_CALLABLE bool is_small(const Lines& lines, int f) {
        const vec3* v = lines.faces + (wp::int64)f * 3;
        const vec3 s = v[1] - v[0], t = v[2] - v[0];
        return fabsf(s[0] * t[1] - s[1] * t[0]) * (float)lines.height * (float)lines.width / 8.0f < SMALL;
    }

    // A pixel that shows a face, among the 3 x 3 around its centroid: its place in memory, or -1.
    static CUDA_CALLABLE wp::int64 middle(const Lines& lines, int f) {
        const vec3* v = lines.faces + (wp::int64)f * 3;
        const int height = lines.height, width = lines.width;
        const float x = 0.5f * ((float)width * ((v[0][0] + v[1][0] + v[2][0]) / 3.0f) + (float)(width - 1));
        const float y = 0.5f * ((float)height * ((v[0][1] + v[1][1] + v[2][1]) / 3.0f) + (float)(height - 1));
        if (!(fabsf(x) < 32768.0f && fabsf(y) < 32768.0f)) return -1;
        const int i = (int)floorf(x + 0.5f), j = (int)floorf(y + 0.5f);
        // The pixel itself, the four beside it, then the four at its corners.
        const int right[9] = {0, 1, -1, 0, 0, 1, 1, -1, -1}, up[9] = {0, 0, 0, 1, -1, 1, -1, 1, -1};
        for (int n = 0; n < 9; ++n) {
            const int column = i + right[n], row = height - 1 - (j + up[n]);
            if (column < 0 || column >= width || row < 0 || row >= height) continue;
            const wp::int64 pixel = (wp::int64)row * width + column;
            if (lines.shown[pixel] == f) return pixel;
        }
        return -1;
    }

    // The gain of both sides, each on its own.
    static CUDA_CALLABLE float gain_of_sides(
        const Lines& lines, const Edge& edge, const Crossing& at, bool shows_own, bool shows_adjacent
    ) {
        if (!(shows_own || shows_adjacent)) return 0.0f;
        // Pixels around the pair: two on either side along the line, and those beside the pair.
        const int d = edge.outward;
        const int across[8] = {0, 0, 0, 0, -1, -1, 1, 1}, along[8] = {-1, -2, 2, 3, 0, 1, 0, 1};
        wp::int64 around[8];
        int count = 0;
        for (int n = 0; n < 8; ++n) {
            const int u = at.u + across[n], v = at.inner + d * along[n];
            if (u < 0 || u >= lines.count || v < 0 || v >= lines.length) continue;
            const wp::int64 pixel = lines.pixel(u, v);
            const int shown = lines.shown[pixel];
            if (shown >= 0 && shown != edge.face && shown != edge.adjacent) around[count++] = pixel;
        }
        float own = 0.0f, adjacent = 0.0f;
        if (shows_own) own = Lines::weight(lines.chord(edge.face, at.u, at.v, at.v));
        if (shows_adjacent) adjacent = Lines::weight(lines.chord(edge.adjacent, at.u, at.v, at.v));
        const wp::int64 inner = lines.pixel(at.u, at.inner), outer = lines.pixel(at.u, at.outer);
        // Without other faces, subtract the colour of the side that is shown more often.
        const wp::int64 middle = shows_own && (!shows_adjacent || own <= adjacent) ? inner : outer;
        const wp::int64 inner_pull = lines.pull(at.u, at.inner), outer_pull = lines.pull(at.u, at.outer);
        const float *channel = lines.image, *pull = lines.grad;
        float result = 0.0f;
        for (int c = 0; c < lines.channels; ++c, channel += lines.area, pull += lines.grad_area) {
            float mean = 0.0f;
            for (int n = 0; n < count; ++n) mean += channel[around[n]];
            mean = count > 0 ? mean / (float)count : channel[middle];
            const float difference = own * (channel[inner] - mean) - adjacent * (channel[outer] - mean);
            result += difference * ((1.0f - at.offset) * pull[inner_pull] + at.offset * pull[outer_pull]);
        }
        return result;
    }

    // The gain at a crossing; 0 where a colour is unknown, or something hides the seam.
    static CUDA_CALLABLE float gain(const Lines& lines, const Edge& edge, const Crossing& at) {
        const bool shows_own = at.inner_face == edge.face, shows_adjacent = at.outer_face == edge.adjacent;
        if (edge.small) return gain_of_sides(lines, edge, at, shows_own, shows_adjacent);
        Gain gain;
        gain.set(lines, edge, at);
        // Where a centre lies in a face but does not show it, another face hides the seam.
        if (!shows_own) {
            if (at.offset < lines.chord(edge.face, at.u, at.v, at.v)) return 0.0f;
            gain.inside.near = middle(lines, edge.face);
            if (gain.inside.near < 0) return 0.0f;
        }
        if (!shows_adjacent) {
            if (1.0f - at.offset < lines.chord(edge.adjacent, at.u, at.v, at.v)) return 0.0f;
            gain.outside.near = middle(lines, edge.adjacent);
            if (gain.outside.near < 0) return 0.0f;
        }
        // A colour from the middle of a face is not extrapolated.
        gain.inside.extrapolate(1.0f, at.offset, gain.before_is_inside && shows_own);
        gain.outside.extrapolate(1.0f, 1.0f - at.offset, gain.behind_is_outside && shows_adjacent);
        return gain.sum(lines, at, false);
    }
};
"""
SEAMS = fill(_SEAMS, SMALL=f"{SMALL!r}f")
