"""Seams: edges between two visible faces of one surface, across which the colour may jump.

The gradient at a seam needs the colours of both faces, from pixels that show them. The pixels beside the seam may miss
a narrow face. Then the pixel at the middle of the face is used. If a face is small, the seam is instead weighted by the
inverse of the probability that two neighbouring pixels show both faces.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import to_pixels
from .crossings import LEAST_CHORD, Crossing, Edge, chord, face_at, pixel_at
from .gains import boundary_gain, extrapolated, next_inside, next_outside

wp.set_module_options({"enable_backward": False})

# Largest area of a small face, in pixels. Measured: below it the middle of a face is rarely visible; above it a pair of
# pixels rarely shows both faces.
SMALL = wp.constant(1.5)


@wp.func
def seam_gain(
    edge: Edge,
    at: Crossing,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
) -> float:
    """Compute the gain at a crossing of a seam; 0 where its colours are unknown. See `boundary_gain`."""
    weight, inner_color, outer_color = seam_pixels(edge, at, faces, image, face_index)
    if weight == 0.0:
        return 0.0
    # A colour from the middle of a face is not extrapolated.
    linear_inside = next_inside(edge, at, face_index) == at.inner_face and at.inner_face == edge.face
    linear_outside = next_outside(edge, at, face_index) == at.outer_face and at.outer_face == edge.adjacent
    inside = extrapolated(weight, at.offset, linear_inside)
    outside = extrapolated(weight, 1.0 - at.offset, linear_outside)
    return boundary_gain(edge, at, inner_color, outer_color, weight, inside, outside, image, grad)


@wp.func
def seam_pixels(
    edge: Edge,
    at: Crossing,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
):
    """Weight a crossing of the seam between a face and the adjacent one, and find a pixel with the colour of each.

    A weight of 0 means that no colour is known, or that something hides the seam.
    """
    inner_pixel = pixel_at(image, edge.image, edge.axis, at.u, at.inner)
    outer_pixel = pixel_at(image, edge.image, edge.axis, at.u, at.outer)
    shows_own = at.inner_face == edge.face
    shows_adjacent = at.outer_face == edge.adjacent
    weight = float(1.0)
    if edge.small:
        if not (shows_own and shows_adjacent):
            return 0.0, inner_pixel, outer_pixel
        # The inverse of the probability that two centres, a pixel apart, show both faces.
        own_chord = chord(faces, edge.face, edge, at.u, at.v, at.v)
        adjacent_chord = chord(faces, edge.adjacent, edge, at.u, at.v, at.v)
        weight = 1.0 / wp.max(own_chord + adjacent_chord - 1.0, LEAST_CHORD)
        return weight, inner_pixel, outer_pixel
    # Where a centre lies in a face but does not show it, another face hides the seam.
    if not shows_own:
        inner_pixel = wp.int64(-1)
        if at.offset >= chord(faces, edge.face, edge, at.u, at.v, at.v):
            inner_pixel = middle_pixel(faces, edge.image, edge.face, image, face_index)
    if not shows_adjacent and inner_pixel >= wp.int64(0):
        outer_pixel = wp.int64(-1)
        if 1.0 - at.offset >= chord(faces, edge.adjacent, edge, at.u, at.v, at.v):
            outer_pixel = middle_pixel(faces, edge.image, edge.adjacent, image, face_index)
    if inner_pixel < wp.int64(0) or outer_pixel < wp.int64(0):
        weight = 0.0
    return weight, inner_pixel, outer_pixel


@wp.func
def is_small(faces: wp.array3d(dtype=wp.vec3), b: int, face: int, height: int, width: int) -> bool:
    """Test whether a face is smaller than SMALL."""
    s = faces[b, face, 1] - faces[b, face, 0]
    t = faces[b, face, 2] - faces[b, face, 0]
    return wp.abs(s[0] * t[1] - s[1] * t[0]) * float(height) * float(width) / 8.0 < SMALL


@wp.func
def middle_pixel(
    faces: wp.array3d(dtype=wp.vec3),
    b: int,
    face: int,
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
) -> wp.int64:
    """Find a pixel that shows a face, among the 3 x 3 around its centroid: an offset as from `pixel_at`, or -1."""
    v0 = faces[b, face, 0]
    v1 = faces[b, face, 1]
    v2 = faces[b, face, 2]
    x = to_pixels((v0[0] + v1[0] + v2[0]) / 3.0, image.shape[3])
    y = to_pixels((v0[1] + v1[1] + v2[1]) / 3.0, image.shape[2])
    if not (wp.abs(x) < 32768.0 and wp.abs(y) < 32768.0):
        return wp.int64(-1)
    i = int(wp.floor(x + 0.5))
    j = int(wp.floor(y + 0.5))
    for n in range(9):
        # The pixel itself, the four beside it, then the four at its corners.
        right = (int(n == 1) - int(n == 2)) + (int(n == 5) + int(n == 6) - int(n == 7) - int(n == 8))
        up = (int(n == 3) - int(n == 4)) + (int(n == 5) - int(n == 6) + int(n == 7) - int(n == 8))
        row = j + up
        if row >= 0 and row < image.shape[2]:
            if face_at(face_index, b, 0, row, i + right, image.shape[3]) == face:
                return pixel_at(image, b, 0, row, i + right)
    return wp.int64(-1)
