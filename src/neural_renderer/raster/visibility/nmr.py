"""The paper's approximate gradient through visibility, as an operation on an image (paper, section 3.2).

Forward it is the identity. Backward it asks, for every edge of every seen face and every scan line that the edge
crosses, what each pixel of the line would change to if the edge moved there, whether that would lower the loss, and how
far the edge's corners would have to travel. How the image was shaded does not matter.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..ops.visible_faces import seen_faces
from ..warp.geometry import SHORTEST, facing, to_pixels
from ..warp.launch import array, concurrent, copy, face_lanes, launch, zeros
from ..warp.registration import differentiable_once, operator
from .scanlines import WIDE, copy_lines, empty_lines, place, shrink, sweep

wp.set_module_options({"enable_backward": False})

# Keeps a quotient finite where a pixel lies on the edge and the corner has no share in it.
TINY = wp.constant(1.0e-15)
# Bytes of scan lines that are stored at once: on the CPU no more than its caches hold, or so.
_ROOM, _ROOM_CONCURRENT = 2**23, 2**28


@operator
def nmr_edges(image: Tensor, faces: Tensor, face_index: Tensor, eps: float, two_sided: bool, binary: bool) -> Tensor:
    """The image unchanged; its gradient also flows to the faces' x and y, by the estimator "nmr".

    image: [B, C, H, W] float32, any number of channels, background included, before anti-aliasing.
    faces: [B, F, 3, 3] float32 screen-space corners; face_index: [B, H, W] int32, as `coverage` returns it.
    eps: added to every distance (screen units), which bounds the gradient of a pixel that touches the edge.
    two_sided: faces whose corners run clockwise are seen too.
    The gains are differences of sums: of a contrast below some 1e-5 of the values themselves little is left in float32.
    binary: the image is the silhouette, 1 where a face is seen and 0 elsewhere; the result is the same without, slower.
    """
    return copy(image)


@torch.library.register_fake("neural_renderer::nmr_edges")
def _(image, faces, face_index, eps, two_sided, binary):  # type: ignore[no-untyped-def]
    return torch.empty_like(image, memory_format=torch.contiguous_format)


@differentiable_once
def nmr_edges_backward(
    grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, eps: float, two_sided: bool, binary: bool
) -> Tensor:
    """The gradient [B, F, 3, 3] that `nmr_edges` sends to its faces; z gets none."""
    grad, image, faces = grad.contiguous(), image.contiguous(), faces.contiguous()
    batch, channels, height, width = image.shape
    result = zeros(faces.shape, faces.device)
    if result.numel() == 0 or image.numel() == 0:
        return result
    device = faces.device

    # The last channels, such as an alpha that no loss looks at, may have no gradient. (To ask on a GPU is to wait.)
    while not (binary or concurrent(device) or channels == 1 or bool(grad[:, channels - 1].any())):
        channels -= 1
    planes = 1 if binary else 1 + channels
    abreast = 1 if concurrent(device) else WIDE
    lanes = face_lanes(faces, height * width)
    # Zero would divide by zero where a pixel touches the edge.
    options = [int(binary), max(eps, 1e-12), int(two_sided), lanes]
    seen = seen_faces(face_index, faces.shape[1])
    room = _ROOM_CONCURRENT if concurrent(device) else _ROOM
    at_once = max(1, min(batch, room // (8 * planes * height * width)))
    rows = empty_lines(at_once, height, width, planes, device)
    columns = empty_lines(at_once, width, height, planes, device)
    spans = torch.empty((at_once, height + width, 2), dtype=torch.int32, device=device)
    lines = [array(rows), array(columns), array(spans, wp.vec2i)]
    for first in range(0, batch, at_once):
        here = slice(first, first + at_once)
        images = min(at_once, batch - first)
        shown = array(image[here])
        tasks = images * (-(-height // abreast) - (-width // abreast))
        launch(copy_lines, tasks, [shown, array(grad[here]), *lines, abreast], device)
        arguments = [array(faces[here], wp.vec3), shown, array(face_index[here]), *lines, array(seen[here]), *options]
        launch(_pull, images * faces.shape[1] * lanes, [*arguments, array(result[here], wp.vec3)], device)
    return result


@torch.library.register_fake("neural_renderer::nmr_edges_backward")
def _(grad, image, faces, face_index, eps, two_sided, binary):  # type: ignore[no-untyped-def]
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    image, faces, face_index, ctx.eps, ctx.two_sided, ctx.binary = inputs
    ctx.save_for_backward(image, faces, face_index)  # not the output, which callers may change in place


def _backward(ctx, grad):  # type: ignore[no-untyped-def]
    image, faces, face_index = ctx.saved_tensors
    grad = grad.contiguous()  # once, for what comes before the image as well
    to_faces = None
    if ctx.needs_input_grad[1]:
        to_faces = nmr_edges_backward(grad, image, faces, face_index, ctx.eps, ctx.two_sided, ctx.binary)
    return grad, to_faces, None, None, None, None


torch.library.register_autograd("neural_renderer::nmr_edges", _backward, setup_context=_save)


@wp.func
def pull_edge(
    b: int,
    f: int,
    axis: int,
    lane: int,
    lanes: int,
    p: wp.vec3,
    q: wp.vec3,
    r: wp.vec3,
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    lines: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    eps: float,
    binary: int,
) -> wp.vec2:
    """The gradient that the edge p -> q of a counter-clockwise face with third corner r sends to p and q.

    axis 0: to x, by the rows the edge crosses; axis 1: to y, by the columns. Scan lines are numbered by u and run along
    v, in pixel units from the bottom left.
    """
    height = image.shape[2]
    width = image.shape[3]
    count = width
    length = height
    first_line = height
    if axis == 0:
        count = height
        length = width
        first_line = int(0)
    channels = lines.shape[2] - 1
    plane = wp.int64(lines.shape[3])
    pu = to_pixels(p[1 - axis], count)
    qu = to_pixels(q[1 - axis], count)
    ru = to_pixels(r[1 - axis], count)
    pv = to_pixels(p[axis], length)
    qv = to_pixels(q[axis], length)
    rv = to_pixels(r[axis], length)
    # An edge that ends behind the camera has no place on the screen for its end: it gets no gradient.
    if wp.abs(pu - qu) < SHORTEST or p[2] <= 0.0 or q[2] <= 0.0:
        return wp.vec2(0.0, 0.0)
    outward = int(1)
    if (pu < qu) == (axis == 1):
        outward = int(-1)
    d = float(outward)
    area = wp.int64(height) * wp.int64(width)
    reach = wp.abs(qu - pu) * 2.0 / float(length)
    slope = (qv - pv) / (qu - pu)
    far_p = float(0.0)
    far_q = float(0.0)
    near_p = float(0.0)
    near_q = float(0.0)
    start = int(wp.ceil(wp.clamp(wp.min(pu, qu), 0.0, float(count))))
    stop = int(wp.floor(wp.clamp(wp.max(pu, qu), -1.0, float(count - 1))))
    for u in range(start + lane, stop + 1, lanes):
        c = wp.clamp(pv + slope * (float(u) - pu), -2.0, float(length) + 1.0)
        inner = int(wp.ceil(c))
        if outward > 0:
            inner = int(wp.floor(c))
        outer = inner + outward
        if wp.min(inner, outer) < 0 or wp.max(inner, outer) >= length:
            continue
        inner_row, inner_column = place(axis, u, inner, height)
        outer_row, outer_column = place(axis, u, outer, height)
        image_row = wp.int64(b) * wp.int64(image.shape[1]) * wp.int64(height)
        inner_pixel = (image_row + wp.int64(inner_row)) * wp.int64(width) + wp.int64(inner_column)
        outer_pixel = (image_row + wp.int64(outer_row)) * wp.int64(width) + wp.int64(outer_column)
        # For the edge to reach a pixel at the distance x on this line, p travels reach x / share_p, and q likewise (in
        # screen units): their shares of the gradient, times what the pixels gain, over that and eps. The line through
        # one corner is moved by that corner alone.
        share_p = wp.abs(qu - float(u))
        share_q = wp.abs(float(u) - pu)
        slack_p = eps * share_p + TINY
        slack_q = eps * share_q + TINY
        line = (wp.int64(b) * wp.int64(count) + wp.int64(u)) * wp.int64(lines.shape[2]) * plane + wp.int64(WIDE)
        if face_index[b, inner_row, inner_column] == f:
            span = spans[b, first_line + u]
            begin = wp.max(span[0], outer)
            pixels = span[1] - begin + 1
            if outward < 0:
                begin = wp.min(span[1], outer)
                pixels = begin - span[0] + 1
            if pixels > 0:
                sums = sweep(
                    lines,
                    line + wp.int64(begin),
                    plane,
                    image,
                    inner_pixel,
                    channels,
                    outward,
                    pixels,
                    wp.abs(float(begin) - c),
                    reach,
                    slack_p,
                    slack_q,
                )
                far_p += share_p * sums[0]
                far_q += share_q * sums[1]

        if binary == 1 and face_index[b, outer_row, outer_column] >= 0:
            continue
        # Where the line leaves the face again: through p-r, or through q-r; nowhere if r is behind the camera.
        limit = rv
        if r[2] <= 0.0:
            limit = float(wp.where(outward > 0, 0, length))
        elif (pu < float(u) and float(u) < ru) or (ru < float(u) and float(u) < pu):
            limit = pv + (rv - pv) * (float(u) - pu) / (ru - pu)
        elif qu != ru:
            limit = qv + (rv - qv) * (float(u) - qu) / (ru - qu)
        limit = wp.clamp(limit, 0.0, float(length - 1))
        last = int(wp.floor(limit))
        if outward > 0:
            last = int(wp.ceil(limit))
        pixels = (inner - last) * outward + 1
        if pixels > 0:
            step = -outward
            if axis == 1:
                step = outward * width
            sums = shrink(
                lines,
                line + wp.int64(inner),
                plane,
                image,
                outer_pixel,
                channels,
                -outward,
                pixels,
                wp.abs(float(inner) - c),
                reach,
                slack_p,
                slack_q,
                f,
                face_index,
                inner_pixel - wp.int64(b) * wp.int64(image.shape[1] - 1) * area,
                step,
            )
            near_p += share_p * sums[0]
            near_q += share_q * sums[1]
    return d * wp.vec2(near_p - far_p, near_q - far_q)


@wp.kernel
def _pull(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    seen: wp.array2d(dtype=int),
    binary: int,
    eps: float,
    two_sided: int,
    lanes: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """One face of one image; with several lanes, each takes every n-th scan line."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    if seen[b, f] == 0:
        return
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    side = facing(v0, v1, v2, 1)
    turned = side < 0
    if turned:
        v0, v2 = v2, v0
    x = wp.vec3(0.0, 0.0, 0.0)
    y = wp.vec3(0.0, 0.0, 0.0)
    corners = int(3)  # a variable, or Warp would unroll the loop sixfold
    for k in range(corners):
        p, q, r = v0, v1, v2
        if k == 1:
            p, q, r = v1, v2, v0
        if k == 2:
            p, q, r = v2, v0, v1
        to_x = pull_edge(b, f, 0, lane, lanes, p, q, r, image, face_index, rows, spans, eps, binary)
        to_y = pull_edge(b, f, 1, lane, lanes, p, q, r, image, face_index, columns, spans, eps, binary)
        x[k] += to_x[0]
        y[k] += to_y[0]
        x[(k + 1) % 3] += to_x[1]
        y[(k + 1) % 3] += to_y[1]
    for k in range(3):
        corner = k
        if turned:
            corner = 2 - k
        part = wp.vec3(x[k], y[k], 0.0)
        if lanes == 1:
            result[b, f, corner] = part
        else:
            wp.atomic_add(result, b, f, corner, part)
