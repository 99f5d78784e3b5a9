"""The paper's approximate gradient through visibility, as an operation on an image (paper, section 3.2).

Forward it is the identity. Backward it asks, for every edge of every seen face and every scan line that the edge crosses,
what each pixel of the line would change to if the edge moved there, whether that would lower the loss, and how far the
edge's corners would have to travel. How the image was shaded does not matter.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from .geometry import facing, to_pixels
from .launch import array, face_lanes, launch

wp.set_module_options({"enable_backward": False})

# Pixels of a scan line that are handled at once: one vector register or two.
WIDE = 16
# The travel of a corner that no movement of its own brings nearer.
NEVER = wp.constant(1.0e12)
Pixels = wp.types.vector(length=WIDE, dtype=wp.float32)


@torch.library.custom_op("neural_renderer::nmr_edges", mutates_args=())
def nmr_edges(image: Tensor, faces: Tensor, face_index: Tensor, eps: float, two_sided: bool, binary: bool) -> Tensor:
    """The image unchanged; its gradient also flows to the faces' x and y, by the estimator "nmr".

    image: [B, H, W, C] float32, any number of channels, background included, before anti-aliasing.
    faces: [B, F, 3, 3] float32 screen-space corners; face_index: [B, H, W] int32, as `coverage` returns it.
    eps: added to every distance (screen units), which bounds the gradient of a pixel that touches the edge.
    two_sided: faces whose corners run clockwise are seen too.
    binary: the image is the silhouette, 1 where a face is seen and 0 elsewhere; the result is the same without, slower.
    """
    return image.clone()


@nmr_edges.register_fake
def _(image, faces, face_index, eps, two_sided, binary):  # type: ignore[no-untyped-def]
    return torch.empty_like(image, memory_format=torch.contiguous_format)


@torch.library.custom_op("neural_renderer::nmr_edges_backward", mutates_args=())
def nmr_edges_backward(
    grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, eps: float, two_sided: bool, binary: bool
) -> Tensor:
    """The gradient [B, F, 3, 3] that `nmr_edges` sends to its faces; z gets none."""
    grad, image, faces = grad.contiguous(), image.contiguous(), faces.contiguous()
    batch, height, width, channels = image.shape
    result = torch.zeros_like(faces)
    if result.numel() == 0 or image.numel() == 0:
        return result
    device = faces.device

    def lines(count: int, length: int) -> Tensor:
        return torch.empty((batch, channels, count, -(-length // WIDE), WIDE), device=device)

    row_image, row_grad, column_image, column_grad = (
        array(lines(*shape), Pixels) for shape in ((height, width), (height, width), (width, height), (width, height))
    )
    spans = array(torch.empty((batch, height + width, 2), dtype=torch.int32, device=device), wp.vec2i)
    seen = array(torch.zeros(faces.shape[:2], dtype=torch.int32, device=device))
    maps = [array(image), array(grad), array(face_index)]
    by_line = [row_image, row_grad, column_image, column_grad, spans]
    launch(_prepare, batch * (height + width), [*maps, *by_line, seen, int(binary)], device)
    arguments = [array(faces, wp.vec3), *maps, *by_line, seen, eps, int(two_sided), int(binary)]
    lanes = face_lanes(faces, height * width)
    launch(_pull, batch * faces.shape[1] * lanes, [*arguments, lanes, array(result, wp.vec3)], device)
    return result


@nmr_edges_backward.register_fake
def _(grad, image, faces, face_index, eps, two_sided, binary):  # type: ignore[no-untyped-def]
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    _, faces, face_index, ctx.eps, ctx.two_sided, ctx.binary = inputs
    ctx.save_for_backward(output, faces, face_index)


def _backward(ctx, grad):  # type: ignore[no-untyped-def]
    image, faces, face_index = ctx.saved_tensors
    to_faces = None
    if ctx.needs_input_grad[1]:
        to_faces = nmr_edges_backward(grad, image, faces, face_index, ctx.eps, ctx.two_sided, ctx.binary)
    return grad, to_faces, None, None, None, None


nmr_edges.register_autograd(_backward, setup_context=_save)


@wp.kernel
def _prepare(
    first: int,
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    row_image: wp.array4d(dtype=Pixels),
    row_grad: wp.array4d(dtype=Pixels),
    column_image: wp.array4d(dtype=Pixels),
    column_grad: wp.array4d(dtype=Pixels),
    spans: wp.array2d(dtype=wp.vec2i),
    seen: wp.array2d(dtype=int),
    binary: int,
):
    """One scan line (rows first, then columns; counted from the bottom left): its pixels side by side, channel by channel,
    and the span outside which no pixel can pull an edge outward. Also marks the faces that are seen."""
    task = first + wp.tid()
    height = image.shape[1]
    width = image.shape[2]
    b = task // (height + width)
    line = task % (height + width)
    length = width
    if line >= height:
        length = height
    low = length
    high = int(-1)
    for c in range(image.shape[3]):
        for chunk in range((length + WIDE - 1) // WIDE):
            values = Pixels()
            pulls = Pixels()
            for k in range(WIDE):
                v = chunk * WIDE + k
                if v < length:
                    row = height - 1 - line
                    column = v
                    if line >= height:
                        row = height - 1 - v
                        column = line - height
                    value = image[b, row, column, c]
                    pull = grad[b, row, column, c]
                    values[k] = value
                    pulls[k] = pull
                    if pull < 0.0 or (pull > 0.0 and binary == 0):
                        if binary == 0 or value < 1.0:
                            low = wp.min(low, v)
                            high = wp.max(high, v)
                    if line < height and c == 0:
                        f = face_index[b, row, column]
                        if f >= 0:
                            seen[b, f] = 1
            if line < height:
                row_image[b, c, line, chunk] = values
                row_grad[b, c, line, chunk] = pulls
            else:
                column_image[b, c, line - height, chunk] = values
                column_grad[b, c, line - height, chunk] = pulls
    spans[b, line] = wp.vec2i(low, high)


@wp.func
def lane_numbers() -> Pixels:
    return Pixels(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0)


@wp.func
def place(axis: int, u: int, v: int, height: int):
    """Row (from the top) and column of the pixel v on scan line u."""
    if axis == 0:
        return height - 1 - u, v
    return height - 1 - v, u


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
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    line_image: wp.array4d(dtype=Pixels),
    line_grad: wp.array4d(dtype=Pixels),
    spans: wp.array2d(dtype=wp.vec2i),
    eps: float,
    binary: int,
) -> wp.vec2:
    """The gradient that the edge p -> q of a counter-clockwise face with third corner r sends to p and q.

    axis 0: to x, by the rows the edge crosses; axis 1: to y, by the columns. Scan lines are numbered by u and run along
    v, in pixel units from the bottom left.
    """
    height = image.shape[1]
    width = image.shape[2]
    lines = width
    length = height
    first_line = height
    if axis == 0:
        lines = height
        length = width
        first_line = int(0)
    pu = to_pixels(p[1 - axis], lines)
    qu = to_pixels(q[1 - axis], lines)
    ru = to_pixels(r[1 - axis], lines)
    pv = to_pixels(p[axis], length)
    qv = to_pixels(q[axis], length)
    rv = to_pixels(r[axis], length)
    # An edge that ends behind the camera has no place on the screen for its end: it gets no gradient.
    if pu == qu or p[2] <= 0.0 or q[2] <= 0.0:
        return wp.vec2(0.0, 0.0)
    outward = int(1)
    if (pu < qu) == (axis == 1):
        outward = int(-1)
    d = float(outward)
    unit = 2.0 / float(length)
    wide_p = Pixels()
    wide_q = Pixels()
    near_p = float(0.0)
    near_q = float(0.0)
    start = int(wp.ceil(wp.max(wp.min(pu, qu), 0.0)))
    stop = int(wp.floor(wp.min(wp.max(pu, qu), float(lines - 1))))
    for u in range(start + lane, stop + 1, lanes):
        c = wp.clamp(pv + (qv - pv) * (float(u) - pu) / (qu - pu), -2.0, float(length) + 1.0)
        inner = int(wp.ceil(c))
        if outward > 0:
            inner = int(wp.floor(c))
        outer = inner + outward
        if wp.min(inner, outer) < 0 or wp.max(inner, outer) >= length:
            continue
        inner_row, inner_column = place(axis, u, inner, height)
        outer_row, outer_column = place(axis, u, outer, height)
        # How far a corner travels, in screen units, for the edge to move by one pixel on this line.
        lever_p = float(NEVER)
        lever_q = float(NEVER)
        if float(u) != qu:
            lever_p = wp.min((qu - pu) / (qu - float(u)) * unit, NEVER)
        if float(u) != pu:
            lever_q = wp.min((qu - pu) / (float(u) - pu) * unit, NEVER)

        if face_index[b, inner_row, inner_column] == f:
            span = spans[b, first_line + u]
            first = wp.max(span[0], outer)
            last = span[1]
            if outward < 0:
                first = span[0]
                last = wp.min(span[1], outer)
            if first <= last:
                for chunk in range(first // WIDE, last // WIDE + 1):
                    step = d * (lane_numbers() + Pixels(float(chunk * WIDE - outer)))
                    gain = Pixels()
                    for channel in range(image.shape[3]):
                        inside = Pixels(image[b, inner_row, inner_column, channel])
                        gain += wp.cw_mul(line_image[b, channel, u, chunk] - inside, line_grad[b, channel, u, chunk])
                    # Only what lowers the loss, and only from `outer` on.
                    gain = wp.cw_mul(wp.max(gain, Pixels(0.0)), wp.min(wp.max(step + Pixels(1.0), Pixels(0.0)), Pixels(1.0)))
                    distance = wp.max(step, Pixels(0.0)) + Pixels(wp.abs(float(outer) - c))
                    travel_p = lever_p * distance + Pixels(eps)
                    travel_q = lever_q * distance + Pixels(eps)
                    share = wp.cw_div(gain, wp.cw_mul(travel_p, travel_q))
                    wide_p += wp.cw_mul(share, travel_q)
                    wide_q += wp.cw_mul(share, travel_p)

        if binary == 1 and face_index[b, outer_row, outer_column] >= 0:
            continue
        # Where the line leaves the face again: through p-r, or through q-r.
        limit = rv
        if (pu < float(u) and float(u) < ru) or (ru < float(u) and float(u) < pu):
            limit = pv + (rv - pv) * (float(u) - pu) / (ru - pu)
        elif qu != ru:
            limit = qv + (rv - qv) * (float(u) - qu) / (ru - qu)
        limit = wp.clamp(limit, 0.0, float(length - 1))
        last = int(wp.floor(limit))
        if outward > 0:
            last = int(wp.ceil(limit))
        for k in range((inner - last) * outward + 1):
            v = inner - k * outward
            row, column = place(axis, u, v, height)
            if face_index[b, row, column] == f:
                better = float(0.0)
                for channel in range(image.shape[3]):
                    beyond = image[b, outer_row, outer_column, channel]
                    better += (image[b, row, column, channel] - beyond) * grad[b, row, column, channel]
                if better > 0.0:
                    away = wp.abs(float(v) - c)
                    near_p += better / (lever_p * away + eps)
                    near_q += better / (lever_q * away + eps)
    to_p = near_p
    to_q = near_q
    for k in range(WIDE):
        to_p -= wide_p[k]
        to_q -= wide_q[k]
    return d * wp.vec2(to_p, to_q)


@wp.kernel
def _pull(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    row_image: wp.array4d(dtype=Pixels),
    row_grad: wp.array4d(dtype=Pixels),
    column_image: wp.array4d(dtype=Pixels),
    column_grad: wp.array4d(dtype=Pixels),
    spans: wp.array2d(dtype=wp.vec2i),
    seen: wp.array2d(dtype=int),
    eps: float,
    two_sided: int,
    binary: int,
    lanes: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """One face of one image; with several lanes, each takes every so manieth scan line."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    if seen[b, f] == 0:
        return
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    side = facing(v0, v1, v2)
    turned = side < 0
    if turned:
        v1, v2 = v2, v1
    x = wp.vec3(0.0, 0.0, 0.0)
    y = wp.vec3(0.0, 0.0, 0.0)
    for k in range(3):
        p, q, r = v0, v1, v2
        if k == 1:
            p, q, r = v1, v2, v0
        if k == 2:
            p, q, r = v2, v0, v1
        to_x = pull_edge(
            b, f, 0, lane, lanes, p, q, r, image, grad, face_index, row_image, row_grad, spans, eps, binary
        )
        to_y = pull_edge(
            b, f, 1, lane, lanes, p, q, r, image, grad, face_index, column_image, column_grad, spans, eps, binary
        )
        x[k] += to_x[0]
        y[k] += to_y[0]
        x[(k + 1) % 3] += to_x[1]
        y[(k + 1) % 3] += to_y[1]
    for k in range(3):
        corner = k
        if turned and k > 0:
            corner = 3 - k
        part = wp.vec3(x[k], y[k], 0.0)
        if lanes == 1:
            result[b, f, corner] = part
        else:
            wp.atomic_add(result, b, f, corner, part)
