"""The gradient through visibility where faces intersect: the motion of the line at which their depths are equal.

Maths. Two neighbouring pixels show two faces that have the same nearness at a point between the pixel centres. Nearness
(see `nearness`) is linear on the screen. Let a be the lead of the own face, the difference of the two nearnesses at its
pixel, and b the lead of the other face at the other pixel. Then the point lies at ``t = a / (a + b)`` pixels from the
first centre. It moves by ``d(lead) / (a + b)`` pixels if a corner changes the lead there. The gradient to the corner,
in x, y and z, is this motion, times the difference of the two colours, times the gradient of the pixel that contains
the point.

Rows and columns both sample the line. Each pair is weighted by the square of the component of the line's normal along
its axis; over the two axes the weights add to 1.

Pitfalls. At the ends of an intersection, up to a pixel of its length is lost. Faces in one plane are skipped, because
their leads are rounding errors. So are faces that share two corners: they meet, but do not intersect. Faces that cross
the camera's plane and `degenerate` faces have no gradient here.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..ops.visible_faces import next_shown, pixels_of_task
from ..warp.geometry import degenerate, in_front, pixel_box, pixel_centre
from ..warp.launch import array, launch, module_for_cuda
from ..warp.layout import face_tasks, in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import zeros
from .candidates import find_candidates, may_meet
from .crossings import border_weight
from .nearness import covers, nearness_slope, nearness_terms, total
from .neighbors import same

wp.set_module_options({"enable_backward": False})


def add_intersections(
    result: Tensor, grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, adjacent: Tensor, perspective: bool
) -> None:
    """Add the gradient of the intersections of faces, in place.

    Args:
        result: Gradient to the corners, [B, F, 3, 3] float32; changed.
        grad: Gradient to the image, [B, C, H, W] float32.
        image: [B, C, H, W] float32.
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32.
        adjacent: Adjacent faces, [B, F, 3] int32, as from `neighbors`.
        perspective: As in `coverage`.
    """
    batch, count = faces.shape[:2]
    height, width = face_index.shape[1:]
    if in_any_order(faces.device):
        arguments = [array(faces, wp.vec3), array(image), array(grad), array(face_index), array(adjacent)]
        tasks, each = pixel_tasks(batch * height, width, faces.device)
        arguments += [int(perspective), each, array(result, wp.vec3)]
        launch(_intersect_pairs, tasks, arguments, faces.device)
        return
    # Most faces have no neighbour that they may intersect. A cheap first pass excludes them.
    candidates = zeros((batch, count), faces.device, torch.int32)
    scene = [array(faces, wp.vec3), array(face_index), array(image), array(adjacent)]
    tasks, each = pixel_tasks(batch * height, width, faces.device)
    launch(
        _find_candidates,
        tasks,
        [*scene, int(perspective), array(candidates), each],
        faces.device,
        worth_a_thread(each * width),
    )
    maps = [array(image), array(grad), array(face_index), array(candidates)]
    arguments = [array(faces, wp.vec3), *maps, int(perspective), array(result, wp.vec3)]
    launch(_intersect, batch * count, arguments, faces.device, face_tasks(faces, height * width))


@wp.kernel
def _find_candidates(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    image: wp.array4d(dtype=float),
    adjacent: wp.array3d(dtype=int),
    perspective: int,
    candidates: wp.array2d(dtype=int),
    each: int,
):
    """Mark the candidates of the pixels of a task. Several tasks may write to one place, but all write 1."""
    find_candidates(faces, face_index, image, adjacent, perspective, candidates, first + wp.tid(), each)


@wp.func
def share_edge(faces: wp.array3d(dtype=wp.vec3), b: int, f: int, g: int) -> bool:
    """Test whether two faces have two corners in common: such faces meet at an edge and do not intersect."""
    count = int(0)
    for k in range(3):
        corner = faces[b, f, k]
        if same(corner, faces[b, g, 0]) or same(corner, faces[b, g, 1]) or same(corner, faces[b, g, 2]):
            count += 1
    return count >= 2


@wp.struct
class Pair:
    """Two neighbouring pixels of an image, (i, j) and (i2, j2): column and row from the bottom left."""

    image: int
    axis: int  # along which they are neighbours
    step: int  # from the first to the second: 1 or -1
    i: int
    j: int
    i2: int
    j2: int


@wp.struct
class Intersection:
    """The point between two pixels at which a face and another one have the same nearness."""

    exists: bool
    t: float  # from the first pixel, in pixels
    lead: float  # sum of the leads of both faces, each at its own pixel
    terms: wp.vec3  # terms of the own face's nearness at the point, by corner
    own_slope: wp.vec2  # change of the own face's nearness over a pixel to the right and up
    other_slope: wp.vec2


@wp.func
def pair_beside(b: int, i: int, j: int, side: int) -> Pair:
    """Pair a pixel with its neighbour on one of four sides: right, left, above, below."""
    pair = Pair()
    pair.image = b
    pair.axis = side // 2
    pair.step = 1 - 2 * (side % 2)
    pair.i = i
    pair.j = j
    pair.i2 = i + pair.step * (1 - pair.axis)
    pair.j2 = j + pair.step * pair.axis
    return pair


@wp.func
def second_face(pair: Pair, face_index: wp.array3d(dtype=int)) -> int:
    """Read the visible face at the second pixel; -1 for none, and outside the image."""
    height = face_index.shape[1]
    if pair.i2 < 0 or pair.i2 >= face_index.shape[2] or pair.j2 < 0 or pair.j2 >= height:
        return -1
    return face_index[pair.image, height - 1 - pair.j2, pair.i2]


@wp.func
def find_intersection(
    faces: wp.array3d(dtype=wp.vec3), f: int, g: int, pair: Pair, height: int, width: int, perspective: int
) -> Intersection:
    """Find where face f, visible at the first pixel of a pair, and face g, visible at the second, are equally near."""
    found = Intersection()
    v0 = faces[pair.image, f, 0]
    v1 = faces[pair.image, f, 1]
    v2 = faces[pair.image, f, 2]
    u0 = faces[pair.image, g, 0]
    u1 = faces[pair.image, g, 1]
    u2 = faces[pair.image, g, 2]
    if in_front(u0, u1, u2, perspective) != 1 or degenerate(u0, u1, u2):
        return found
    x = pixel_centre(pair.i, width)
    y = pixel_centre(pair.j, height)
    x2 = pixel_centre(pair.i2, width)
    y2 = pixel_centre(pair.j2, height)
    own_first = nearness_terms(v0, v1, v2, x, y, perspective)
    own_second = nearness_terms(v0, v1, v2, x2, y2, perspective)
    other_first = nearness_terms(u0, u1, u2, x, y, perspective)
    other_second = nearness_terms(u0, u1, u2, x2, y2, perspective)
    own_lead = total(own_first) - total(other_first)
    other_lead = total(other_second) - total(own_second)
    found.lead = own_lead + other_lead
    # The leads of faces in one plane are rounding errors.
    if not (own_lead > 0.0 and other_lead > 0.0 and found.lead > 1.0e-6 * wp.abs(total(own_first))):
        return found
    found.t = own_lead / found.lead
    found.terms = own_first + found.t * (own_second - own_first)
    other_terms = other_first + found.t * (other_second - other_first)
    if covers(found.terms, perspective) and covers(other_terms, perspective):
        found.exists = True
        pixel = wp.vec2(2.0 / float(width), 2.0 / float(height))
        found.own_slope = nearness_slope(v0, v1, v2, x, y, total(own_first), pixel, perspective)
        found.other_slope = nearness_slope(u0, u1, u2, x, y, total(other_first), pixel, perspective)
    return found


@wp.func
def color_difference(
    pair: Pair, image: wp.array4d(dtype=float), grad: wp.array4d(dtype=float), at_second: bool
) -> float:
    """Sum (first - second colour) * gradient over the channels; ``at_second``: the second pixel has the gradient."""
    b = pair.image
    row = image.shape[2] - 1 - pair.j
    row2 = image.shape[2] - 1 - pair.j2
    result = float(0.0)
    for c in range(image.shape[1]):
        pull = grad[b, c, row, pair.i]
        if at_second:
            pull = grad[b, c, row2, pair.i2]
        result += (image[b, c, row, pair.i] - image[b, c, row2, pair.i2]) * pull
    return result


@wp.func
def nearness_gain(
    found: Intersection, pair: Pair, image: wp.array4d(dtype=float), grad: wp.array4d(dtype=float)
) -> float:
    """Compute the change of the loss if the own face's nearness at an intersection grows by 1."""
    slope = found.own_slope - found.other_slope
    gain = slope[pair.axis] * slope[pair.axis] / wp.dot(slope, slope) / found.lead
    gain *= color_difference(pair, image, grad, found.t >= 0.5)
    v = float(pair.i) + float(pair.step) * found.t
    length = image.shape[3]
    if pair.axis == 1:
        v = float(pair.j) + float(pair.step) * found.t
        length = image.shape[2]
    return gain * border_weight(v, length)


@wp.func
def corner_gradients(
    found: Intersection, gain: float, faces: wp.array3d(dtype=wp.vec3), b: int, f: int, pixel: wp.vec2, perspective: int
) -> wp.mat33:
    """Compute the gradient to x, y and z (rows) of the corners (columns) of the own face f.

    At a fixed position, moving corner k by v on the screen changes the nearness by -w_k grad(nearness) . v, and moving
    its depth by dz changes it by w_k dn_k/dz dz.
    """
    result = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(3):
        z = faces[b, f, k][2]
        w = found.terms[k] * z
        to_z = -w / (z * z)
        if perspective == 0:
            w = -found.terms[k] / z
            to_z = -w
        result[0, k] = -(gain * w * found.own_slope[0] / pixel[0])
        result[1, k] = -(gain * w * found.own_slope[1] / pixel[1])
        result[2, k] = gain * to_z
    return result


@wp.func
def pair_gradients(
    pair: Pair,
    f: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    perspective: int,
) -> wp.mat33:
    """Compute the gradients to the corners of face f, visible at the first pixel of a pair; see `corner_gradients`."""
    other = second_face(pair, face_index)
    if other >= 0 and other != f:
        if not share_edge(faces, pair.image, f, other):
            found = find_intersection(faces, f, other, pair, image.shape[2], image.shape[3], perspective)
            if found.exists:
                gain = nearness_gain(found, pair, image, grad)
                pixel = wp.vec2(2.0 / float(image.shape[3]), 2.0 / float(image.shape[2]))
                return corner_gradients(found, gain, faces, pair.image, f, pixel, perspective)
    return wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@wp.kernel(launch_bounds=(256, 2))
def _intersect(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    candidates: wp.array2d(dtype=int),
    perspective: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """Visit the pixels of one face of one image. The other face of an intersection has another task."""
    task = first + wp.tid()
    b = task // faces.shape[1]
    f = task % faces.shape[1]
    if candidates[b, f] == 0:
        return
    height = face_index.shape[1]
    width = face_index.shape[2]
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    if in_front(v0, v1, v2, perspective) != 1 or degenerate(v0, v1, v2):
        return
    sums = wp.mat33(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    box = pixel_box(v0, v1, v2, 1, height, width)
    for j in range(box[2], box[3] + 1):
        row = wp.int64(b) * wp.int64(height) + wp.int64(height - 1 - j)
        i = next_shown(face_index, row, width, box[0], box[1] + 1, f)
        while i <= box[1]:
            sides = int(4)  # a variable, or Warp would unroll the loop
            for side in range(sides):
                sums += pair_gradients(pair_beside(b, i, j, side), f, faces, image, grad, face_index, perspective)
            i = next_shown(face_index, row, width, i + 1, box[1] + 1, f)
    for k in range(3):
        result[b, f, k] += wp.vec3(sums[0, k], sums[1, k], sums[2, k])


@wp.func
def add_pair(
    pair: Pair,
    f: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """Add the gradient to face f, visible at the first pixel of a pair, while other threads do so, too."""
    b = pair.image
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    if in_front(v0, v1, v2, perspective) != 1 or degenerate(v0, v1, v2):
        return
    to = pair_gradients(pair, f, faces, image, grad, face_index, perspective)
    for k in range(3):
        wp.atomic_add(result, b, f, k, wp.vec3(to[0, k], to[1, k], to[2, k]))


@wp.kernel(launch_bounds=(256, 2), module=module_for_cuda(__name__))
def _intersect_pairs(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    adjacent: wp.array3d(dtype=int),
    perspective: int,
    each: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """Pair the pixels of a task of `pixel_tasks` with the next ones, to the right and below, on CUDA."""
    task = first + wp.tid()
    height = int(face_index.shape[1])
    width = int(face_index.shape[2])
    line, left, right = pixels_of_task(task, each, width)
    b = line // height
    row = line % height
    for i in range(left, right):
        f = face_index[b, row, i]
        directions = int(2)  # a variable, or Warp would unroll the loop
        if f < 0:
            directions = 0
        for k in range(directions):
            pair = pair_beside(b, i, height - 1 - row, 3 * k)  # to the right, and below
            other = second_face(pair, face_index)
            if other >= 0 and other != f:
                if may_meet(faces, adjacent, b, f, other, i, row, k, height, width, perspective):
                    add_pair(pair, f, faces, image, grad, face_index, perspective, result)
                    back = pair_beside(b, pair.i2, pair.j2, 1 + k)  # to the left, and above
                    add_pair(back, other, faces, image, grad, face_index, perspective, result)
