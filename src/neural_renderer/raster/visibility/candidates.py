"""Candidates for intersections: faces with a visible neighbour that they may intersect.

The test is cheap and visits each pixel once. Most faces fail it, and the kernel of `intersections` skips them.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.layout import PIXELS_OF_TASK
from ..warp.point import VECTORS, fill
from .nearness import NEARNESS

wp.set_module_options({"enable_backward": False})


# Two faces that are visible at two neighbouring pixels can intersect between them only if together they cover the whole
# way from one pixel to the other. Each face covers it from its own pixel to the first of its edges.
_MAY_MEET = """
    struct Way {
        typedef wp::vec_t<3, float> vec3;
        static CUDA_CALLABLE float covered(const vec3* v, float x, float y, float x2, float y2) {
            const float area = (v[1][0] - v[0][0]) * (v[2][1] - v[0][1]) - (v[1][1] - v[0][1]) * (v[2][0] - v[0][0]);
            float end = 1.0f;
            for (int k = 0; k < 3; ++k) {
                const vec3 &p = v[k], &q = v[k == 2 ? 0 : k + 1];
                const float s = area < 0.0f ? -1.0f : 1.0f, dx = s * (q[0] - p[0]), dy = s * (q[1] - p[1]);
                const float here = dx * (y - p[1]) - dy * (x - p[0]), there = dx * (y2 - p[1]) - dy * (x2 - p[0]);
                const float doubt = 1.0e-6f * (fabsf(dx) + fabsf(dy));
                const bool leaves = (there < -doubt) & (here > there);
                const float at = (leaves ? here + doubt : 1.0f) / (leaves ? here - there : 1.0f);
                end = at < end ? at : end;
            }
            return end;
        }
    };
"""

# Test of two faces: f, shown at pixel i of a row, and another one, shown at the next pixel to the right (k is 0) or
# below (k is 1). ``v`` and ``u`` are their corners, and ``next`` the faces that are adjacent to f.
_PAIR = """
    struct Pair {
        typedef wp::vec_t<3, float> vec3;
        static CUDA_CALLABLE bool may_meet(
            const vec3* v, const vec3* u, const int* next, int other, int i, int row, int k, int height, int width,
            int perspective
        ) {
            if ((other == next[0]) | (other == next[1]) | (other == next[2])) return false;
            if (perspective && !((v[0][2] > 0.0f) & (v[1][2] > 0.0f) & (v[2][2] > 0.0f)
                                 & (u[0][2] > 0.0f) & (u[1][2] > 0.0f) & (u[2][2] > 0.0f))) return true;
            const float across = 2.0f / (float)width, down = 2.0f / (float)height;
            const float x = (float)(2 * i + 1 - width) / (float)width;
            const float y = (float)(height - 1 - 2 * row) / (float)height;
            const float x2 = k == 0 ? x + across : x, y2 = k == 0 ? y : y - down;
            if (Way::covered(v, x, y, x2, y2) + Way::covered(u, x2, y2, x, y) < 0.999f) return false;
            const float own_here = Nearness::at(v, x, y, perspective);
            const float ahead = own_here - Nearness::at(u, x, y, perspective);
            const float own_there = Nearness::at(v, x2, y2, perspective);
            const float short_of = Nearness::at(u, x2, y2, perspective) - own_there;
            return ahead > 0.0f && short_of > 0.0f && ahead + short_of > 1.0e-6f * fabsf(own_here);
        }
    };
"""

# Pairs of neighbours are found eight at once on the CPU. The pixels of one face, and those without a face, have none.
_FIND = """
    const int height = face_index.shape[1], width = face_index.shape[2], channels = image.shape[1];
    const int all = face_index.shape[0] * height;
    const wp::int64 area = (wp::int64)height * width;
    const int steps[2] = {1, width};
    PIXELS_OF_TASK
    for (int line = first; line < last; ++line) {
        const int b = line / height, row = line % height;
        const wp::int64 start = (wp::int64)row * width, own = b * (wp::int64)adjacent.shape[1];
        const int* shown = face_index.data + b * area + start;
        const float* colors = image.data + b * channels * area + start;
        for (int k = 0; k < 2; ++k) {
            if (k == 1 && row + 1 == height) break;
            const int end = k == 0 && right == width ? right - 1 : right;  // the last pixel has none to the right
            for (int at = left; at < end; at += 8) {
                unsigned pairs = 0;  // bit n: pixel at + n and the next one show two faces
                #if !defined(__CUDA_ARCH__)
                if (at + 8 <= end) {
                    Vectors::ints here, next;
                    memcpy(&here, shown + at, sizeof(here)), memcpy(&next, shown + at + steps[k], sizeof(next));
                    pairs = Vectors::bits((here != next) & (here >= 0) & (next >= 0));
                } else
                #endif
                for (int i = at; i < end && i < at + 8; ++i) {
                    const int next = shown[i + steps[k]];
                    pairs |= (unsigned)(shown[i] != next & shown[i] >= 0 & next >= 0) << (i - at);
                }
                for (int n = 0; pairs; ++n, pairs >>= 1) {
                    #if !defined(__CUDA_ARCH__)
                    const int skipped = __builtin_ctz(pairs);
                    n += skipped, pairs >>= skipped;
                    #else
                    if ((pairs & 1) == 0) continue;
                    #endif
                    MARK
                }
            }
        }
    }
"""
_MARK = """
                    const int i = at + n, f = shown[i], other = shown[i + steps[k]];
                    const wp::vec_t<3, float> *v = faces.data + (own + f) * 3, *u = faces.data + (own + other) * 3;
                    const int* next = adjacent.data + (own + f) * 3;
                    if (!Pair::may_meet(v, u, next, other, i, row, k, height, width, perspective)) continue;
                    bool differs = false;
                    for (int c = 0; c < channels; ++c)
                        differs |= colors[c * area + i] != colors[c * area + i + steps[k]];
                    if (differs) candidates.data[own + f] = candidates.data[own + other] = 1;
"""


@wp.func_native(VECTORS + NEARNESS + _MAY_MEET + _PAIR + fill(_FIND, PIXELS_OF_TASK=PIXELS_OF_TASK, MARK=_MARK))
def find_candidates(
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    image: wp.array4d(dtype=float),
    adjacent: wp.array3d(dtype=int),
    perspective: int,
    candidates: wp.array2d(dtype=int),
    task: int,
    each: int,
):
    """Mark pairs of faces that may intersect between a pixel of a task and the next one, to the right or below.

    Adjacent faces of one surface and pixels of equal colour are skipped.
    """
    ...


@wp.func_native(
    NEARNESS
    + _MAY_MEET
    + _PAIR
    + """
    const wp::int64 own = b * (wp::int64)adjacent.shape[1];
    const wp::vec_t<3, float> *v = faces.data + (own + f) * 3, *u = faces.data + (own + other) * 3;
    return Pair::may_meet(v, u, adjacent.data + (own + f) * 3, other, i, row, k, height, width, perspective);
"""
)
def may_meet(
    faces: wp.array3d(dtype=wp.vec3),
    adjacent: wp.array3d(dtype=int),
    b: int,
    f: int,
    other: int,
    i: int,
    row: int,
    k: int,
    height: int,
    width: int,
    perspective: int,
) -> bool:
    """Test whether two faces may intersect between pixel i of a row and the next one, to the right (k = 0) or below."""
    ...
