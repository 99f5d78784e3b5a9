"""Outlines: edges of a face with the background or a farther face across them.

The chord of a face is the length of a scan line inside the face. If it is shorter than a pixel, a pixel centre hits it
with a probability equal to its length, so the crossing is weighted by the inverse. If the surface continues behind the
chord, a centre in the next faces (the stand-ins, a chain) shows the outline as well, and the chord runs through them.

Two surfaces may meet at an edge without being adjacent, as at a T-junction, where the edge of one meets a corner in the
middle of it. Then each has half of the gain. This is right if they move together; a gap that opens is not seen.

``OUTLINES`` declares a C++ struct for native functions, after `CROSSINGS`, `GAINS` and `NEARNESS`.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.memory import empty
from ..warp.point import fill
from .neighbors import neighbors

# Compiled with the kernels of `neighbors`, which are needed before: a module of its own would take longer.
_MODULE = wp.get_module(neighbors.__module__)

# Most faces behind the outline's own that stand in for it: a bevel of three strips. To search more takes time.
LONGEST = 6
SAME_DEPTH = 1e-5  # relative difference of nearness up to which two surfaces meet
SAME_PLACE = 0.02  # pixels between their ends up to which they do

_OUTLINES = """
struct Outline {
    // The part of the gain that the edge has beside the face at the outer pixel: none if it passes in front of the
    // crossing, and so hides or cuts the edge; half if it ends there, at the same depth.
    static CUDA_CALLABLE float part(const Lines& lines, const Edge& edge, const Crossing& at) {
        float x = (2.0f * at.v + 1.0f - (float)lines.length) / (float)lines.length;
        float y = (2.0f * (float)at.u + 1.0f - (float)lines.count) / (float)lines.count;
        if (lines.axis == 1) {
            const float other = x;
            x = y, y = other;
        }
        const int perspective = lines.perspective;
        const float own = (1.0f - at.share) * Nearness::of(edge.pz, perspective)
            + at.share * Nearness::of(edge.qz, perspective);
        const vec3* corners = lines.faces + (wp::int64)at.outer_face * 3;
        const float ahead = own - Nearness::of_plane(corners, x, y, perspective);
        if (fabsf(ahead) > SAME_DEPTH * fabsf(own)) return ahead > 0.0f ? 1.0f : 0.0f;
        for (int k = 0; k < 3; ++k) {
            const vec3 &a = corners[k], &b = corners[k == 2 ? 0 : k + 1];
            const float au = lines.u_of(a), bu = lines.u_of(b), av = lines.v_of(a), u = (float)at.u;
            if ((au <= u) == (bu <= u)) continue;
            if (fabsf(av + (lines.v_of(b) - av) * (u - au) / (bu - au) - at.v) < SAME_PLACE) return 0.5f;
        }
        return ahead > 0.0f ? 1.0f : 0.0f;
    }

    // The gain at a crossing with the background or a farther face outside; else 0.
    static CUDA_CALLABLE float gain(const Lines& lines, const Edge& edge, const Crossing& at) {
        if (at.inner_face < 0) return 0.0f;
        const float u = (float)at.u;
        float own = 1.0f, joint = 1.0f;  // chords from the crossing on: of the face, and of both
        const int before = lines.face(at.u, at.inner - edge.outward);
        bool shows = at.inner_face == edge.face, shows_before = false;  // the inner pixel, and the one before it
        if (!lines.perspective || edge.rz > 0.0f) {  // otherwise the third corner is behind the camera
            const bool through_pr = (edge.pu <= u) != (edge.ru <= u);
            float exit = edge.rv;
            if (through_pr) exit = edge.pv + (edge.rv - edge.pv) * (u - edge.pu) / (edge.ru - edge.pu);
            else if (edge.qu != edge.ru) exit = edge.qv + (edge.rv - edge.qv) * (u - edge.qu) / (edge.ru - edge.qu);
            own = joint = wp::min(fabsf(exit - at.v), 1.0f);
            // Behind a chord shorter than a pixel, follow the surface along the line.
            int next = through_pr ? edge.adjacent_pr : edge.adjacent_qr;
            for (int n = 0; n < LONGEST && next >= 0 && joint < 1.0f; ++n) {
                shows |= at.inner_face == next, shows_before |= before == next;
                int through;
                exit = lines.exit(next, at.u, exit, through);
                joint = wp::min(fabsf(exit - at.v), 1.0f);
                next = through < 0 ? -1 : lines.adjacent[(wp::int64)next * 3 + through];
            }
        }
        if (!shows) return 0.0f;
        const float share = at.outer_face >= 0 ? part(lines, edge, at) : 1.0f;
        if (share == 0.0f) return 0.0f;
        const float weight = Lines::weight(joint);
        Gain gain;
        gain.set(lines, edge, at);
        gain.inside.extrapolate(weight, at.offset, gain.before_is_inside);
        gain.outside.extrapolate(weight, 1.0f - at.offset, gain.behind_is_outside);
        if (shows_before && at.inner_face == edge.face) {
            // The stand-in's colour, plus the face's difference from it. The difference has the larger weight of the
            // face alone, which centres hit less often.
            gain.inside.near_weight = Lines::weight(own);
            gain.inside.next_weight = weight - gain.inside.near_weight;
        }
        return share * gain.sum(lines, at, weight > 1.0f);
    }
};
"""
OUTLINES = fill(_OUTLINES, LONGEST=str(LONGEST), SAME_DEPTH=f"{SAME_DEPTH!r}f", SAME_PLACE=f"{SAME_PLACE!r}f")


def steps_to_visible(visible: Tensor, adjacent: Tensor) -> Tensor:
    """Count the steps from each face, over adjacent faces, to the next one that is visible. For the CPU.

    Args:
        visible: 1 for each visible face, [B, F + 1] int32, as from `visible_faces`.
        adjacent: [B, F, 3] int32, as from `neighbors`.

    Returns:
        [B, F] int32: 0 for visible faces; LONGEST + 1 if there are more than LONGEST steps.
    """
    batch, count = adjacent.shape[:2]
    room = empty((2, batch, count), adjacent.device, torch.int32)
    launch(_count_steps, batch, [array(visible), array(adjacent), array(room)], adjacent.device)
    return room[0]


# Faces that are hidden improve their steps by those of adjacent faces, until none does.
_COUNT = """
    const wp::int64 faces = adjacent.shape[1], own = b * faces;
    const int *shown = visible.data + b * (faces + 1), *next = adjacent.data + own * 3;
    int *steps = room.data + own, *hidden = steps + room.shape[1] * faces, count = 0;
    for (int f = 0; f < faces; ++f) {
        steps[f] = shown[f] ? 0 : LONGEST + 1;
        const bool lonely = (next[3 * f] < 0) & (next[3 * f + 1] < 0) & (next[3 * f + 2] < 0);
        hidden[count] = f, count += !(shown[f] | lonely);
    }
    bool improves = true;
    for (int n = 0; n < LONGEST && improves; ++n) {
        improves = false;
        for (int i = 0; i < count; ++i) {
            const int f = hidden[i];
            int least = steps[f];
            for (int k = 0; k < 3; ++k) {
                const int g = next[3 * f + k];
                const int through = g < 0 ? LONGEST + 1 : steps[g] + 1;
                least = through < least ? through : least;
            }
            improves |= least < steps[f], steps[f] = least;
        }
    }
"""


@wp.func_native(fill(_COUNT, LONGEST=str(LONGEST)))
def count_steps(visible: wp.array2d(dtype=int), adjacent: wp.array3d(dtype=int), room: wp.array3d(dtype=int), b: int):
    """Count the steps of the faces of image b into the first half of ``room``; the second is a list of faces."""
    ...


@wp.kernel(module=_MODULE)
def _count_steps(
    first: int, visible: wp.array2d(dtype=int), adjacent: wp.array3d(dtype=int), room: wp.array3d(dtype=int)
):
    """Count the steps of all faces of an image."""
    count_steps(visible, adjacent, room, first + wp.tid())
