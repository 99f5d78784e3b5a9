"""Outlines: edges of a face with the background or a farther face across them.

The chord of a face is the length of a scan line inside the face. If it is shorter than a pixel, a pixel centre hits it
with a probability equal to its length, so the crossing is weighted by the inverse. If the surface continues behind the
chord, a centre in the adjacent face shows the outline as well, and the chord runs through both faces.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from .crossings import LEAST_CHORD, Crossing, Edge, chord, exit_from_face, leaves_through_pr, pixel_at
from .gains import boundary_gain, extrapolated, next_inside, next_outside
from .nearness import nearness, nearness_terms, plane_nearness, total

wp.set_module_options({"enable_backward": False})


@wp.struct
class Chord:
    """The part of a scan line in a face, from a crossing on; lengths in pixels, at most 1."""

    own: float
    stand_in: int  # the adjacent face behind a chord shorter than a pixel, which centres may hit instead; or -1
    joint: float  # through the face and the stand-in


@wp.func
def chord_from(edge: Edge, at: Crossing, faces: wp.array3d(dtype=wp.vec3), perspective: int) -> Chord:
    """Measure the chord of a face from a crossing of its edge; 1 if its third corner is behind the camera."""
    result = Chord()
    result.own = 1.0
    result.stand_in = -1
    result.joint = 1.0
    if perspective == 0 or edge.rz > 0.0:
        leave = exit_from_face(edge, at.u)
        result.own = wp.min(wp.abs(leave - at.v), 1.0)
        result.joint = result.own
        if result.own < 1.0:
            result.stand_in = edge.adjacent_qr
            if leaves_through_pr(edge, at.u):
                result.stand_in = edge.adjacent_pr
            if result.stand_in >= 0:
                result.joint = chord(faces, result.stand_in, edge, at.u, leave, at.v)
    return result


@wp.func
def is_behind_plane(edge: Edge, at: Crossing, faces: wp.array3d(dtype=wp.vec3), perspective: int) -> bool:
    """Test whether the face at the outer pixel passes in front of the crossing and so hides or cuts the edge."""
    x = (2.0 * at.v + 1.0 - float(edge.length)) / float(edge.length)
    y = (2.0 * float(at.u) + 1.0 - float(edge.lines)) / float(edge.lines)
    if edge.axis == 1:
        x, y = y, x
    own = (1.0 - at.share) * nearness(edge.pz, perspective) + at.share * nearness(edge.qz, perspective)
    v0 = faces[edge.image, at.outer_face, 0]
    v1 = faces[edge.image, at.outer_face, 1]
    v2 = faces[edge.image, at.outer_face, 2]
    return plane_nearness(v0, v1, v2, x, y, perspective) >= own


@wp.func
def folds_behind(
    faces: wp.array3d(dtype=wp.vec3), folds: wp.array3d(dtype=int), b: int, f: int, k: int, perspective: int
) -> bool:
    """Test whether a surface folds at edge k of face f, and the other face of the fold is in front of f."""
    other = folds[b, f, k]
    if other < 0:
        return False
    v0 = faces[b, other, 0]
    v1 = faces[b, other, 1]
    v2 = faces[b, other, 2]
    r = faces[b, f, (k + 2) % 3]
    if perspective == 1 and (v0[2] <= 0.0 or v1[2] <= 0.0 or v2[2] <= 0.0 or r[2] <= 0.0):
        return False
    return total(nearness_terms(v0, v1, v2, r[0], r[1], perspective)) > nearness(r[2], perspective)


@wp.func
def outline_gain(
    edge: Edge,
    at: Crossing,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    perspective: int,
) -> float:
    """Compute the gain at a crossing of an outline, with the background or a farther face outside; else 0."""
    if at.inner_face < 0:
        return 0.0
    line = chord_from(edge, at, faces, perspective)
    if at.inner_face != edge.face and at.inner_face != line.stand_in:
        return 0.0
    if at.outer_face >= 0:
        if is_behind_plane(edge, at, faces, perspective):
            return 0.0
    weight = 1.0 / wp.max(line.joint, LEAST_CHORD)
    before_face = next_inside(edge, at, face_index)
    inside = extrapolated(weight, at.offset, before_face == at.inner_face)
    outside = extrapolated(weight, 1.0 - at.offset, next_outside(edge, at, face_index) == at.outer_face)
    if line.stand_in >= 0 and before_face == line.stand_in and at.inner_face == edge.face:
        # The stand-in's colour, plus the face's difference from it. The difference has the larger weight of the face
        # alone, which centres hit less often.
        own_weight = 1.0 / wp.max(line.own, LEAST_CHORD)
        inside = wp.vec2(own_weight, weight - own_weight)
    inner_color = pixel_at(image, edge.image, edge.axis, at.u, at.inner)
    outer_color = pixel_at(image, edge.image, edge.axis, at.u, at.outer)
    return boundary_gain(edge, at, inner_color, outer_color, weight, inside, outside, image, grad)
