"""What a scan line meets where it crosses an edge: the pixels and the faces beside it, and what its motion changes."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from ..warp.geometry import homogeneous_weights, to_pixels
from .scanlines import place

wp.set_module_options({"enable_backward": False})

# A crossing of a face that is seen on a line with a small probability counts the more, up to the inverse of this: more
# would be noise, and what is lost is a fiftieth of a pixel.
LEAST_RUN = wp.constant(0.02)
# Faces of less area, in pixels, are often missed by all centres. Measured: below it the colour of the middle is too
# often not to be had, above it a pair of pixels that shows both faces.
SMALL = wp.constant(1.5)


_GAIN = """
    #pragma clang fp contract(fast)
    const wp::int64 area = (wp::int64)image.shape[2] * image.shape[3];
    // The gradient of the pixel that contains the boundary. A centre within a narrow face lies to one side of it in the
    // mean: there, between the two pixels.
    const float share = narrow ? away : away < 0.5f ? 0.0f : 1.0f;
    float sum = 0.0f;
    for (int c = 0; c < image.shape[1]; ++c) {
        const float* value = image.data + c * area;
        const float inside = weights[0] * value[before] + weights[1] * value[own];
        const float outside = weights[2] * value[other] + weights[3] * value[behind];
        const float* pull = grad.data + c * area;
        sum += (inside - outside) * ((1.0f - share) * pull[inner] + share * pull[outer]);
    }
    return sum;
"""


@wp.func_native(_GAIN)
def gain(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    before: wp.int64,
    own: wp.int64,
    other: wp.int64,
    behind: wp.int64,
    weights: wp.vec4,
    inner: wp.int64,
    outer: wp.int64,
    away: float,
    narrow: bool,
) -> float:
    """What the loss changes by if the boundary between two pixels moves outward by a pixel.

    before, own | other, behind: pixels in the first channel; weights: theirs, in this order, in the colours on the two
    sides.
    inner | outer: the pixels next to the boundary. away: from ``inner`` to it.
    narrow: whether a side is narrower than a pixel here.
    """
    ...


@wp.func
def nearness(z: float, perspective: int) -> float:
    """What is linear on the screen over a face, and larger for what hides the other."""
    if perspective == 1:
        return 1.0 / z
    return -z


@wp.func
def plane_nearness(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float, perspective: int) -> float:
    """The nearness of a face's plane at a place on the screen; between its corners' if they are before the camera."""
    a = homogeneous_weights(v0, v1, v2, x, y)
    near = float(a[0] + a[1] + a[2])
    if perspective == 0:
        near = -float(a[0]) * v0[2] * v0[2] - float(a[1]) * v1[2] * v1[2] - float(a[2]) * v2[2] * v2[2]
    elif v0[2] <= 0.0 or v1[2] <= 0.0 or v2[2] <= 0.0:
        return near
    # Not beyond the face's own: seen edge on, its plane goes anywhere within a pixel.
    n0 = nearness(v0[2], perspective)
    n1 = nearness(v1[2], perspective)
    n2 = nearness(v2[2], perspective)
    return wp.clamp(near, wp.min(n0, wp.min(n1, n2)), wp.max(n0, wp.max(n1, n2)))


@wp.func
def leaves(pu: float, pv: float, qu: float, qv: float, ru: float, rv: float, u: float) -> float:
    """Where line u, which crosses the edge p - q of a triangle, leaves it again: through p - r or q - r."""
    limit = rv
    if (pu <= u) != (ru <= u):
        limit = pv + (rv - pv) * (u - pu) / (ru - pu)
    elif qu != ru:
        limit = qv + (rv - qv) * (u - qu) / (ru - qu)
    return limit


@wp.func
def end_of(
    faces: wp.array3d(dtype=wp.vec3), b: int, g: int, axis: int, u: int, v: float, count: int, length: int
) -> float:
    """Where line u, which at v enters the face g, leaves it again."""
    end = v
    for k in range(3):
        p = faces[b, g, k]
        q = faces[b, g, (k + 1) % 3]
        pu = to_pixels(p[1 - axis], count)
        qu = to_pixels(q[1 - axis], count)
        if (pu <= float(u)) != (qu <= float(u)):
            pv = to_pixels(p[axis], length)
            at = pv + (to_pixels(q[axis], length) - pv) * (float(u) - pu) / (qu - pu)
            if wp.abs(at - v) > wp.abs(end - v):
                end = at
    return end


@wp.func
def pixel_at(image: wp.array4d(dtype=float), b: int, axis: int, u: int, v: int) -> wp.int64:
    """Where the pixel v of scan line u lies in the image's memory, in the first channel."""
    row, column = place(axis, u, v, image.shape[2])
    first_row = wp.int64(b) * wp.int64(image.shape[1]) * wp.int64(image.shape[2])
    return (first_row + wp.int64(row)) * wp.int64(image.shape[3]) + wp.int64(column)


@wp.func
def face_at(face_index: wp.array3d(dtype=int), b: int, axis: int, u: int, v: int, length: int) -> int:
    """The face at the pixel v of scan line u; -2 beyond the image."""
    if v < 0 or v >= length:
        return -2
    row, column = place(axis, u, v, face_index.shape[1])
    return face_index[b, row, column]


@wp.func
def area_of(faces: wp.array3d(dtype=wp.vec3), b: int, g: int, image: wp.array4d(dtype=float)) -> float:
    """A face's area in pixels."""
    a = faces[b, g, 1] - faces[b, g, 0]
    c = faces[b, g, 2] - faces[b, g, 0]
    return wp.abs(a[0] * c[1] - a[1] * c[0]) * float(image.shape[2]) * float(image.shape[3]) / 8.0


@wp.func
def middle_of(
    faces: wp.array3d(dtype=wp.vec3), b: int, g: int, image: wp.array4d(dtype=float), face_index: wp.array3d(dtype=int)
) -> wp.int64:
    """A pixel that shows a face near its middle, as `pixel_at` counts, or -1 if there is none."""
    v0 = faces[b, g, 0]
    v1 = faces[b, g, 1]
    v2 = faces[b, g, 2]
    x = to_pixels((v0[0] + v1[0] + v2[0]) / 3.0, image.shape[3])
    y = to_pixels((v0[1] + v1[1] + v2[1]) / 3.0, image.shape[2])
    if not (wp.abs(x) < 32768.0 and wp.abs(y) < 32768.0):
        return wp.int64(-1)
    i = int(wp.floor(x + 0.5))
    j = int(wp.floor(y + 0.5))
    for n in range(9):
        # Itself, the pixels beside it, those at its corners.
        right = (int(n == 1) - int(n == 2)) + (int(n == 5) + int(n == 6) - int(n == 7) - int(n == 8))
        up = (int(n == 3) - int(n == 4)) + (int(n == 5) - int(n == 6) + int(n == 7) - int(n == 8))
        row = j + up
        if row >= 0 and row < image.shape[2]:
            if face_at(face_index, b, 0, row, i + right, image.shape[3]) == g:
                return pixel_at(image, b, 0, row, i + right)
    return wp.int64(-1)


@wp.func
def seam(
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    b: int,
    axis: int,
    u: int,
    c: float,
    count: int,
    length: int,
    f: int,
    g: int,
    shown: int,
    other: int,
    own_pixel: wp.int64,
    other_pixel: wp.int64,
    away: float,
):
    """How much the seam between the faces f and g counts where line u crosses it at c, and the pixels of their colours.

    shown, own_pixel | other, other_pixel: the face and the pixel before the seam | behind it. A weight of 0: nothing is
    known of it here.
    """
    run = wp.min(wp.abs(end_of(faces, b, f, axis, u, c, count, length) - c), 1.0)
    ahead = wp.min(wp.abs(end_of(faces, b, g, axis, u, c, count, length) - c), 1.0)
    weight = float(1.0)
    if wp.min(area_of(faces, b, f, image), area_of(faces, b, g, image)) < SMALL:
        # Centres may miss such a face. A pair of them shows both with this probability, next to none at the seam's
        # ends.
        weight = 1.0 / wp.max(run + ahead - 1.0, LEAST_RUN)
        if shown != f or other != g:
            weight = 0.0
    elif (shown != f and away < run) or (other != g and 1.0 - away < ahead):
        weight = 0.0  # something hides it
    else:
        # It shows its colour near its middle, where no centre beside the seam meets it.
        if shown != f:
            own_pixel = middle_of(faces, b, f, image, face_index)
        if other != g:
            other_pixel = middle_of(faces, b, g, image, face_index)
        if own_pixel < wp.int64(0) or other_pixel < wp.int64(0):
            weight = 0.0
    return weight, own_pixel, other_pixel


@wp.func
def sewn(
    marks: wp.array4d(dtype=wp.int64),
    faces: wp.array3d(dtype=wp.vec3),
    beyond: wp.array3d(dtype=int),
    b: int,
    f: int,
    k: int,
) -> bool:
    """Whether the marks say that colours go on beyond the edge k of face f."""
    own = wp.min(b, marks.shape[0] - 1)
    last = marks.shape[1] - 1
    mark = marks[own, wp.min(f, last), k, 0]
    g = beyond[b, f, k]
    if mark != wp.int64(0):
        for m in range(3):
            if faces[b, g, (m + 1) % 3] == faces[b, f, k] and faces[b, g, m] == faces[b, f, (k + 1) % 3]:
                return marks[own, wp.min(g, last), m, 1] == mark
    return False


@wp.func
def continued(weight: float, away: float, straight: bool) -> wp.vec2:
    """The colour at a boundary, times a weight, from two pixels: how much the one beside it counts, and the next one.

    away: from the first pixel to the boundary. straight: both show the same face, and the colour goes on along the
    slope between them; else the first alone counts.
    """
    if straight:
        return wp.vec2(weight * (1.0 + away), -weight * away)
    return wp.vec2(weight, 0.0)
