"""Where one face cuts through another: the line of equal depth, which moves with the corners of both."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..ops.visible_faces import next_shown
from ..warp.geometry import degenerate, homogeneous_weights, in_front, pixel_box, pixel_centre
from ..warp.launch import array, face_lanes, launch, zeros
from .neighbors import same

wp.set_module_options({"enable_backward": False})


def add_intersections(
    result: Tensor, grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, beyond: Tensor, perspective: bool
) -> None:
    """Add to ``result`` [B, F, 3, 3] what `boundaries` sends to the corners of faces that cut through each other.

    Two neighbouring pixels show two faces, and between their centres lies a point of both at which their nearness q
    (1 / z; -z without perspective) is equal. q is linear on the screen, so where that line crosses the pair, and how
    the six corners move it, are ratios of differences. Rows and columns share its motion by the squares of the
    components of its normal. A `degenerate` face has no part in it.
    """
    batch, count = faces.shape[:2]
    height, width = face_index.shape[1:]
    # Few faces stand beside one that is not their neighbour; the others have no second look.
    marks = zeros((batch, count), faces.device, torch.int32)
    launch(_mark, batch * height, [array(face_index), array(image), array(beyond), array(marks)], faces.device)
    lanes = face_lanes(faces, height * width)
    maps = [array(image), array(grad), array(face_index), array(marks)]
    arguments = [array(faces, wp.vec3), *maps, int(perspective), lanes, array(result, wp.vec3)]
    launch(_cut, batch * count * lanes, arguments, faces.device)


@wp.func
def shares(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, x: float, y: float, perspective: int) -> wp.vec3:
    """The corners' parts of the nearness, and their sum its value, at a place on the screen: w_k q_k."""
    a = homogeneous_weights(v0, v1, v2, x, y)
    if perspective == 1:
        return wp.vec3(float(a[0]), float(a[1]), float(a[2]))
    return -wp.vec3(float(a[0]) * v0[2] * v0[2], float(a[1]) * v1[2] * v1[2], float(a[2]) * v2[2] * v2[2])


@wp.func
def covers(part: wp.vec3, perspective: int) -> bool:
    """Whether the place of these shares is in the face."""
    if perspective == 1:
        return part[0] >= 0.0 and part[1] >= 0.0 and part[2] >= 0.0
    return part[0] <= 0.0 and part[1] <= 0.0 and part[2] <= 0.0


@wp.func
def total(part: wp.vec3) -> float:
    return part[0] + part[1] + part[2]


_MARK_ROW = """
    const int height = face_index.shape[1], width = face_index.shape[2], channels = image.shape[1];
    const wp::int64 area = (wp::int64)height * width;
    const wp::int64 first = (wp::int64)row * width, faces = b * (wp::int64)beyond.shape[1];
    const int* shown = face_index.data + b * area + first;
    const float* colors = image.data + b * channels * area + first;
    const int steps[2] = {1, width};
    for (int i = 0; i < width; ++i)
        for (int k = 0; k < 2; ++k) {
            if (k == 0 ? i + 1 == width : row + 1 == height) continue;
            const int f = shown[i], other = shown[i + steps[k]];
            if (f == other || f < 0 || other < 0) continue;
            bool differs = false;
            for (int c = 0; c < channels; ++c) differs |= colors[c * area + i] != colors[c * area + i + steps[k]];
            const int* next = beyond.data + (faces + f) * 3;
            if (differs && other != next[0] && other != next[1] && other != next[2])
                marks.data[faces + f] = marks.data[faces + other] = 1;
        }
"""


@wp.func_native(_MARK_ROW)
def mark_row(
    face_index: wp.array3d(dtype=int),
    image: wp.array4d(dtype=float),
    beyond: wp.array3d(dtype=int),
    b: int,
    row: int,
    marks: wp.array2d(dtype=int),
):
    """Mark the faces of a row that stand beside another one, in another colour, which is not the next of the same
    surface; below it, too."""
    ...


@wp.kernel
def _mark(
    first: int,
    face_index: wp.array3d(dtype=int),
    image: wp.array4d(dtype=float),
    beyond: wp.array3d(dtype=int),
    marks: wp.array2d(dtype=int),
):
    task = first + wp.tid()
    height = int(face_index.shape[1])
    mark_row(face_index, image, beyond, task // height, task % height, marks)


@wp.func
def share_edge(faces: wp.array3d(dtype=wp.vec3), b: int, f: int, g: int) -> bool:
    """Whether two corners of the faces are the same: such faces meet, and do not cut each other."""
    count = int(0)
    for k in range(3):
        corner = faces[b, f, k]
        if same(corner, faces[b, g, 0]) or same(corner, faces[b, g, 1]) or same(corner, faces[b, g, 2]):
            count += 1
    return count >= 2


@wp.kernel
def _cut(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    marks: wp.array2d(dtype=int),
    perspective: int,
    lanes: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """One face of one image: each of its pixels with its four neighbours. The other faces have tasks of their own."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    if marks[b, f] == 0:
        return
    height = face_index.shape[1]
    width = face_index.shape[2]
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    if in_front(v0, v1, v2, perspective) != 1 or degenerate(v0, v1, v2):
        return
    sums = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    steps = wp.vec2(2.0 / float(width), 2.0 / float(height))
    box = pixel_box(v0, v1, v2, 1, height, width)
    for j in range(box[2] + lane, box[3] + 1, lanes):
        row = height - 1 - j
        y = pixel_centre(j, height)
        line = wp.int64(b) * wp.int64(height) + wp.int64(row)
        i = next_shown(face_index, line, width, box[0], box[1] + 1, f)
        while i <= box[1]:
            sides = int(4)  # a variable, or Warp would unroll the loop
            for side in range(sides):
                axis = side // 2
                way = 1 - 2 * (side % 2)
                i2 = i
                j2 = j
                if axis == 0:
                    i2 += way
                else:
                    j2 += way
                other = int(-1)
                if i2 >= 0 and i2 < width and j2 >= 0 and j2 < height:
                    other = face_index[b, height - 1 - j2, i2]
                if other >= 0 and other != f and not share_edge(faces, b, f, other):
                    u0 = faces[b, other, 0]
                    u1 = faces[b, other, 1]
                    u2 = faces[b, other, 2]
                    x = pixel_centre(i, width)
                    x2 = pixel_centre(i2, width)
                    y2 = pixel_centre(j2, height)
                    here = shares(v0, v1, v2, x, y, perspective)
                    there = shares(v0, v1, v2, x2, y2, perspective)
                    others_here = shares(u0, u1, u2, x, y, perspective)
                    others_there = shares(u0, u1, u2, x2, y2, perspective)
                    ahead = total(here) - total(others_here)
                    short = total(others_there) - total(there)
                    # Of faces in one plane the difference is rounding.
                    clear = ahead + short > 1.0e-6 * wp.abs(total(here))
                    solid = in_front(u0, u1, u2, perspective) == 1 and not degenerate(u0, u1, u2)
                    if clear and ahead > 0.0 and short > 0.0 and solid:
                        t = ahead / (ahead + short)
                        q = here + t * (there - here)
                        others_q = others_here + t * (others_there - others_here)
                        if covers(q, perspective) and covers(others_q, perspective):
                            # How the two change over a pixel to the right and up.
                            right = total(shares(v0, v1, v2, x + steps[0], y, perspective)) - total(here)
                            up = total(shares(v0, v1, v2, x, y + steps[1], perspective)) - total(here)
                            own = wp.vec2(right, up)
                            right = total(shares(u0, u1, u2, x + steps[0], y, perspective)) - total(others_here)
                            up = total(shares(u0, u1, u2, x, y + steps[1], perspective)) - total(others_here)
                            slope = own - wp.vec2(right, up)
                            part = slope[axis] * slope[axis] / wp.dot(slope, slope) / (ahead + short)
                            jump = float(0.0)
                            for c in range(image.shape[1]):
                                pull = grad[b, c, row, i]
                                if t >= 0.5:
                                    pull = grad[b, c, height - 1 - j2, i2]
                                jump += (image[b, c, row, i] - image[b, c, height - 1 - j2, i2]) * pull
                            part *= jump
                            place = float(i) + float(way) * t
                            last = float(width) - 1.0
                            if axis == 1:
                                place = float(j) + float(way) * t
                                last = float(height) - 1.0
                            if place < 0.5 or place > last - 0.5:
                                part *= 2.0  # of the pixel at the border centres show one half: it stands for the other
                            # With the place fixed, moving corner k by v changes q by -w_k grad(q) . v, and raising its
                            # depth changes it by w_k dq_k / dz_k.
                            for k in range(3):
                                z = faces[b, f, k][2]
                                w = q[k] * z
                                to_z = -w / (z * z)
                                if perspective == 0:
                                    w = -q[k] / z
                                    to_z = -w
                                sums[0, k] -= part * w * own[0] / steps[0]
                                sums[1, k] -= part * w * own[1] / steps[1]
                                sums[2, k] += part * to_z
            i = next_shown(face_index, line, width, i + 1, box[1] + 1, f)
    for k in range(3):
        column = wp.vec3(sums[0, k], sums[1, k], sums[2, k])
        if lanes == 1:
            result[b, f, k] += column
        else:
            wp.atomic_add(result, b, f, k, column)
