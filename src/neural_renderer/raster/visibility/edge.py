"""The derivative of an image through visibility: what moving the visible boundaries changes (`gradient="edge"`).

An image averaged over sub-pixel shifts of the pixel grid changes smoothly with the corners. Where a boundary between
two colours moves, it sweeps over area that changes from the one to the other: the derivative is an integral along the
boundary of its motion times the difference of the colours (Li et al., "Differentiable Monte Carlo ray tracing through
edge sampling", 2018; Reynolds' transport theorem). The rows and the columns of the image sample that integral: the rows
take the motion along x, the columns that along y.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
from typing import Optional

import torch
import warp as wp
from torch import Tensor

from ..ops.visible_faces import seen_faces
from ..warp.geometry import SHORTEST, facing, to_pixels
from ..warp.launch import array, copy, face_lanes, launch, zeros
from ..warp.registration import differentiable_once, operator
from .crossings import (
    LEAST_RUN,
    continued,
    end_of,
    face_at,
    gain,
    leaves,
    nearness,
    pixel_at,
    plane_nearness,
    seam,
    sewn,
)
from .intersections import add_intersections
from .neighbors import neighbors

wp.set_module_options({"enable_backward": False})


@operator
def boundaries(
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    marks: Optional[Tensor] = None,  # noqa: UP045 (schemas are inferred from it)
) -> Tensor:
    """The image unchanged; its gradient also flows to the faces, by the motion of the boundaries that are seen.

    image: [B, C, H, W] float32, any number of channels, background included, before anti-aliasing.
    faces: [B, F, 3, 3] float32 screen-space corners; face_index: [B, H, W] int32, as `coverage` returns it.
    two_sided, perspective: as in `coverage`.
    seams: colours may jump where two faces of a surface meet, as texture cubes and light by the face make them; else,
        such edges are left out, which is right, and quieter, where colours are interpolated.
    marks: [1 or B, F, 3, 2] int64: an edge of two faces that name it in opposite orders is left out too if the first
        mark of the one is the second of the other, and not 0 (see `texture_marks`); None: no edge.

    Where the edge of a face crosses a row between the centres of two pixels, of which the inner shows the face and the
    outer something behind it, x of the edge moves the crossing; the gradient of the pixel that contains the crossing,
    times the difference of the two colours, goes to the edge's corners in the shares of the crossing. Colours are
    continued to the crossing linearly where the next pixel shows the same face. A face narrower than a pixel along the
    row is met by a centre only that often: it counts the more, or the next face of the surface stands in for it; at a
    seam it lends the colour that it shows in its middle. Columns and y likewise. Where one face cuts through another,
    the line of equal depth moves with all their corners, in z as well.

    Exact in the mean over sub-pixel shifts but for: colours that curve within a pixel; gaps narrower than a pixel
    between two boundaries; seams of faces that centres miss: of random colours, a twentieth of their gradient is lost
    where triangles are 2 pixels wide, a fifth at 1.5 and a third at 1; boundaries along the border of the image, closer
    than a pixel; the ends of cuts, by up to a pixel; edges with an end behind the camera.
    """
    return copy(image)


@torch.library.register_fake("neural_renderer::boundaries")
def _(image, faces, face_index, two_sided, perspective, seams, marks=None):  # type: ignore[no-untyped-def]
    return torch.empty_like(image, memory_format=torch.contiguous_format)


@differentiable_once
def boundaries_backward(
    grad: Tensor,
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    marks: Optional[Tensor] = None,  # noqa: UP045
) -> Tensor:
    """The gradient [B, F, 3, 3] that `boundaries` sends to its faces."""
    grad, image, faces = grad.contiguous(), image.contiguous(), faces.contiguous()
    result = zeros(faces.shape, faces.device)
    if result.numel() == 0 or image.numel() == 0:
        return result
    batch, _, height, width = image.shape
    count = faces.shape[1]
    seen = seen_faces(face_index, count)
    beyond = neighbors(faces, two_sided, perspective)
    lanes = face_lanes(faces, height * width)
    arguments = [array(faces, wp.vec3), array(image), array(grad), array(face_index), array(seen), array(beyond)]
    none = torch.zeros((1, 1, 3, 2), dtype=torch.int64, device=faces.device)
    options = [int(perspective), int(seams), array(none if marks is None else marks), lanes, array(result, wp.vec3)]
    launch(_move, batch * count * lanes, [*arguments, *options], faces.device)
    add_intersections(result, grad, image, faces, face_index, beyond, perspective)
    return result


@torch.library.register_fake("neural_renderer::boundaries_backward")
def _(grad, image, faces, face_index, two_sided, perspective, seams, marks=None):  # type: ignore[no-untyped-def]
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    image, faces, face_index, ctx.two_sided, ctx.perspective, ctx.seams, marks = inputs
    ctx.save_for_backward(image, faces, face_index, marks)  # not the output, which callers may change in place


def _backward(ctx, grad):  # type: ignore[no-untyped-def]
    image, faces, face_index, marks = ctx.saved_tensors
    to_faces = None
    if ctx.needs_input_grad[1]:
        to_faces = boundaries_backward(grad, image, faces, face_index, ctx.two_sided, ctx.perspective, ctx.seams, marks)
    return grad, to_faces, None, None, None, None, None


torch.library.register_autograd("neural_renderer::boundaries", _backward, setup_context=_save)


@wp.func
def move_edge(
    b: int,
    f: int,
    axis: int,
    lane: int,
    lanes: int,
    p: wp.vec3,
    q: wp.vec3,
    r: wp.vec3,
    next_pq: int,
    next_pr: int,
    next_qr: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    perspective: int,
) -> wp.vec2:
    """The gradient to x (axis 0) or y (axis 1) of p and q, from the lines that the edge p -> q crosses.

    The face is counter-clockwise with the third corner r; next_: the faces beyond its edges. Lines are numbered by u
    and run along v, in pixel units.
    """
    count = image.shape[3]
    length = image.shape[2]
    if axis == 0:
        count = image.shape[2]
        length = image.shape[3]
    pu = to_pixels(p[1 - axis], count)
    qu = to_pixels(q[1 - axis], count)
    pv = to_pixels(p[axis], length)
    qv = to_pixels(q[axis], length)
    ru = to_pixels(r[1 - axis], count)
    rv = to_pixels(r[axis], length)
    if wp.abs(pu - qu) < SHORTEST or (perspective == 1 and (p[2] <= 0.0 or q[2] <= 0.0)):
        return wp.vec2(0.0, 0.0)
    d = int(1)
    if (pu < qu) == (axis == 1):
        d = -1
    slope = (qv - pv) / (qu - pu)
    to_p = float(0.0)
    to_q = float(0.0)
    start = int(wp.ceil(wp.clamp(wp.min(pu, qu), 0.0, float(count))))
    stop = int(wp.ceil(wp.clamp(wp.max(pu, qu), 0.0, float(count))))
    for u in range(start + lane, stop, lanes):
        c = wp.clamp(pv + slope * (float(u) - pu), -2.0, float(length) + 1.0)
        inner = int(wp.ceil(c))
        if d > 0:
            inner = int(wp.floor(c))
        outer = inner + d
        shown = face_at(face_index, b, axis, u, inner, length)
        other = face_at(face_index, b, axis, u, outer, length)
        if shown == -2 or other == -2 or other == shown or (next_pq >= 0 and next_pq < f):
            continue  # the first of its two faces takes a seam
        share = (float(u) - pu) / (qu - pu)
        away = wp.abs(c - float(inner))
        last = length - 1
        before = pixel_at(image, b, axis, u, wp.clamp(inner - d, 0, last))
        behind = pixel_at(image, b, axis, u, wp.clamp(outer + d, 0, last))
        inner_pixel = pixel_at(image, b, axis, u, inner)
        outer_pixel = pixel_at(image, b, axis, u, outer)
        own_pixel = inner_pixel
        other_pixel = outer_pixel
        third = face_at(face_index, b, axis, u, inner - d, length)
        goes_on = third == shown
        goes_on_outside = face_at(face_index, b, axis, u, outer + d, length) == other
        run = float(1.0)
        both = float(1.0)
        weight = float(1.0)
        second = int(-1)
        if next_pq >= 0:
            weight, own_pixel, other_pixel = seam(
                faces, image, face_index, b, axis, u, c, count, length, f, next_pq, shown, other, inner_pixel,
                outer_pixel, away,
            )  # fmt: skip
            if weight == 0.0:
                continue
            # The colour of a face's middle is taken as it is.
            goes_on = goes_on and shown == f
            goes_on_outside = goes_on_outside and other == next_pq
            both = 1.0 / weight
        elif shown < 0:
            continue
        else:
            # How far the line runs through the face. Where that is less than a pixel, and the surface goes on, the next
            # face stands in for this one where the centres miss it.
            if perspective == 0 or r[2] > 0.0:
                by_p = (pu <= float(u)) != (ru <= float(u))
                limit = leaves(pu, pv, qu, qv, ru, rv, float(u))
                run = wp.min(wp.abs(limit - c), 1.0)
                both = run
                if run < 1.0:
                    second = next_qr
                    if by_p:
                        second = next_pr
                    if second >= 0:
                        both = wp.min(wp.abs(end_of(faces, b, second, axis, u, limit, count, length) - c), 1.0)
            if shown != f and shown != second:
                continue
            weight = 1.0 / wp.max(both, LEAST_RUN)
            if other >= 0:
                x = (2.0 * c + 1.0 - float(length)) / float(length)
                y = (2.0 * float(u) + 1.0 - float(count)) / float(count)
                if axis == 1:
                    x, y = y, x
                own = (1.0 - share) * nearness(p[2], perspective) + share * nearness(q[2], perspective)
                if plane_nearness(faces[b, other, 0], faces[b, other, 1], faces[b, other, 2], x, y, perspective) >= own:
                    continue  # what is seen there hides the edge, or moves by itself
        inside = continued(weight, away, goes_on)
        outside = continued(weight, 1.0 - away, goes_on_outside)
        if not goes_on and shown == f and second >= 0 and third == second:
            # What this face's colour differs by from the next one's, seen only so often.
            inside = wp.vec2(1.0 / wp.max(run, LEAST_RUN), weight - 1.0 / wp.max(run, LEAST_RUN))
        weights = wp.vec4(inside[1], inside[0], outside[0], outside[1])
        part = gain(
            image, grad, before, own_pixel, other_pixel, behind, weights, inner_pixel, outer_pixel, away, both < 1.0
        )  # fmt: skip
        if c < 0.5 or c > float(length) - 1.5:
            part *= 2.0  # of the pixel at the border centres show one half: it stands for the other
        to_p += (1.0 - share) * part
        to_q += share * part
    return 0.5 * float(d * length) * wp.vec2(to_p, to_q)


@wp.kernel
def _move(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    seen: wp.array2d(dtype=int),
    beyond: wp.array3d(dtype=int),
    perspective: int,
    seams: int,
    marks: wp.array4d(dtype=wp.int64),
    lanes: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """The edges of one face of one image; with several lanes, each takes every n-th scan line."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    # A face that is missed by all centres still has its edges, if a neighbour can stand in for it.
    near = seen[b, f]
    for k in range(3):
        if beyond[b, f, k] >= 0:
            near += seen[b, beyond[b, f, k]]
    if near == 0:
        return
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    turned = facing(v0, v1, v2, perspective) < 0
    x = wp.vec3(0.0, 0.0, 0.0)
    y = wp.vec3(0.0, 0.0, 0.0)
    corners = int(3)  # a variable, or Warp would unroll the loop sixfold
    for k in range(corners):
        if beyond[b, f, k] < 0 or (seams == 1 and not sewn(marks, faces, beyond, b, f, k)):
            m = (k + 1) % 3
            n = (k + 2) % 3
            p = faces[b, f, k]
            q = faces[b, f, m]
            next_pr = beyond[b, f, n]
            next_qr = beyond[b, f, m]
            if turned:
                p, q = q, p
                next_pr, next_qr = next_qr, next_pr
            to_x = move_edge(
                b, f, 0, lane, lanes, p, q, faces[b, f, n], beyond[b, f, k], next_pr, next_qr, faces, image, grad,
                face_index, perspective,
            )  # fmt: skip
            to_y = move_edge(
                b, f, 1, lane, lanes, p, q, faces[b, f, n], beyond[b, f, k], next_pr, next_qr, faces, image, grad,
                face_index, perspective,
            )  # fmt: skip
            if turned:
                to_x = wp.vec2(to_x[1], to_x[0])
                to_y = wp.vec2(to_y[1], to_y[0])
            x[k] += to_x[0]
            x[m] += to_x[1]
            y[k] += to_y[0]
            y[m] += to_y[1]
    for k in range(3):
        part = wp.vec3(x[k], y[k], 0.0)
        if lanes == 1:
            result[b, f, k] = part
        else:
            wp.atomic_add(result, b, f, k, part)
