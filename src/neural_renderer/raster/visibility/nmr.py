"""The paper's approximate gradient through visibility, as an operation on an image (paper, section 3.2).

The forward pass is the identity. The backward pass imagines that an edge of a visible face moves along a row or column
until it reaches a pixel, which then changes its colour. If this lowers the loss (to first order, by the pixel's
gradient), each corner of the edge gets a gradient: the decrease of the loss, divided by the distance that the corner
travels, summed over all pixels of the line. The gradient depends on the image alone, not on how it was shaded.

Source: Kato, Ushiku and Harada, "Neural 3D Mesh Renderer", CVPR 2018, section 3.2.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
from typing import Optional

import torch
import warp as wp
from torch import Tensor

from ..colors.downsample import averaged, halve_backward, like_averaged
from ..ops.visible_faces import visible_faces
from ..warp.geometry import SHORTEST, facing
from ..warp.launch import array, launch, no_array
from ..warp.layout import concurrent, face_tasks, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.queue import launch_lines, line_queue, line_task, queue_arrays, queued_threads
from ..warp.registration import differentiable, differentiable_once, operator
from .line_sums import SCAN_LINE
from .scanlines import WIDE, copy_lines, copy_pixels, empty_lines

wp.set_module_options({"enable_backward": False})

# CUDA threads that share a scan line: neighbours, whose pixels lie in one sector of memory. And their most lines.
_LANES = 8
_MOST = wp.constant(4)
# Keeps the quotient finite if a pixel lies on the edge and the corner's share is 0.
TINY = 1.0e-15
# Most bytes of scan lines that are stored at once: on the CPU about the size of its caches.
_ROOM, _ROOM_CONCURRENT = 2**23, 2**28


@operator
def nmr_gradient(
    image: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    faces: Tensor,
    face_index: Tensor,
    eps: float,
    two_sided: bool,
    halved: bool = False,
) -> Tensor:
    """Return the image and send a gradient to the x and y of faces, by the estimator "nmr".

    Contrasts below about 1e-5 of the values are lost to float32 rounding, because the loss's decrease is computed as a
    difference of sums.

    Args:
        image: [B, C, H, W] float32, any number of channels, with its background, before anti-aliasing. None stands for
            the silhouette, of one channel: the result is the same, but faster.
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32, as from `coverage`.
        eps: Added to every distance, in screen units. It bounds the gradient of pixels that touch the edge.
        two_sided: Whether faces whose corners run clockwise are drawn.
        halved: Whether to average blocks of 2 x 2 pixels (anti-aliasing), which saves a copy of the image.

    Returns:
        [B, C, H, W] float32, or [B, C, H / 2, W / 2] if ``halved``.
    """
    return averaged(image, face_index, halved)


@torch.library.register_fake("neural_renderer::nmr_gradient")
def _(image, faces, face_index, eps, two_sided, halved=False):
    return like_averaged(image, face_index, halved)


@differentiable_once
def nmr_gradient_backward(
    grad: Tensor,
    image: Optional[Tensor],  # noqa: UP045
    faces: Tensor,
    face_index: Tensor,
    eps: float,
    two_sided: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `nmr_gradient` to faces and to the image.

    Args:
        grad: Gradient to the image, [B, C, H, W] float32; or to the means of its blocks of 2 x 2 pixels,
            [B, C, H / 2, W / 2].
        image, faces, face_index, eps, two_sided: As in `nmr_gradient`.

    Returns:
        To faces, [B, F, 3, 3]; 0 to z. To the image, [B, C, H, W]; empty if ``grad`` is that, and for the silhouette.
    """
    grad, faces = grad.contiguous(), faces.contiguous()
    batch, height, width = face_index.shape
    device = faces.device
    result, to_image = zeros(faces.shape, device), grad.new_empty((0, 0, 0, 0))
    blocks = image is not None and grad.shape[2] < height
    if blocks and concurrent(device) and grad.numel() and result.numel():
        to_image = empty(image.shape, device)  # written by `copy_pixels`
    elif blocks:
        to_image = grad = halve_backward(grad)
    if result.numel() == 0 or grad.numel() == 0:
        return result, to_image

    planes = 1
    if image is not None:
        image, channels = image.contiguous(), image.shape[1]
        # The last channels, such as an unused alpha, may have no gradient. On a GPU this test would wait for it.
        while not (concurrent(device) or channels == 1 or bool(grad[:, channels - 1].any())):
            channels -= 1
        planes = 1 + channels
    # With eps = 0, a pixel that touches the edge would divide by zero.
    eps = max(eps, 1e-12)
    count = faces.shape[1]
    room = _ROOM_CONCURRENT if concurrent(device) else _ROOM
    at_once = max(1, min(batch, room // (8 * planes * height * width)))
    rows = empty_lines(at_once, height, width, planes, device)
    columns = empty_lines(at_once, width, height, planes, device)
    spans = torch.empty((0 if concurrent(device) else at_once, height + width, 2), dtype=torch.int32, device=device)
    lines = [array(rows), array(columns), array(spans, wp.vec2i)]
    queue = line_queue(at_once * count, device)
    visible = visible_faces(face_index, count) if queue is None else None
    for first in range(0, batch, at_once):
        here = slice(first, first + at_once)
        images = min(at_once, batch - first)
        colors = no_array(4, device) if image is None else array(image[here])
        shown = array(face_index[here])
        corners = array(faces[here], wp.vec3)
        maps = [colors, array(grad[here]), shown, *lines]
        if concurrent(device):
            # In one piece of memory, to clear it at once: the total of the queue, the faces in it, and the spans.
            sizes = (2, images * count if queue else 0, images * (height + width) * 2)
            total, queued, spans = zeros((sum(sizes),), device, torch.int32).split(sizes)
            queue = queue and (queue[0], total.view(torch.int64))
            lines[2] = maps[5] = array(spans.view(images, height + width, 2), wp.vec2i)
            filled = [array(queued.view(images if queue else 0, count)), *queue_arrays(queue, device)]
            spread = array(to_image[here]) if blocks else no_array(4, device)
            tasks, each = pixel_tasks(images * height, width, device)
            launch(copy_pixels, tasks, [*maps, spread, corners, *filled, _LANES, int(_MOST), each], device)
        else:
            tasks = images * (-(-height // WIDE) - (-width // WIDE))
            launch(copy_lines, tasks, [*maps, WIDE], device, worth_a_thread(WIDE * width))
        mask = no_array(2, device) if visible is None else array(visible[here])
        arguments = [corners, colors, shown, *lines, mask, eps, array(result[here], wp.vec3)]
        launch_lines(_pull, arguments, images * count, queue, _LANES, device, face_tasks(faces, height * width))
    return result, to_image


@torch.library.register_fake("neural_renderer::nmr_gradient_backward")
def _(grad, image, faces, face_index, eps, two_sided):
    blocks = image is not None and grad.shape[2] < face_index.shape[1]
    to_image = grad.new_empty(image.shape if blocks else (0, 0, 0, 0))
    return torch.empty_like(faces, memory_format=torch.contiguous_format), to_image


def _save(ctx, inputs, output):
    image, faces, face_index, ctx.eps, ctx.two_sided, ctx.halved = inputs
    ctx.save_for_backward(image, faces, face_index)  # not the output, which callers may change in place


def _backward(ctx, grad):
    image, faces, face_index = ctx.saved_tensors
    grad = grad.contiguous()  # once; earlier operators need it, too
    to_image = to_faces = None
    if ctx.needs_input_grad[1]:
        to_faces, to_image = nmr_gradient_backward(grad, image, faces, face_index, ctx.eps, ctx.two_sided)
    elif ctx.halved and image is not None:
        to_image = halve_backward(grad)
    if image is None:
        to_image = None
    elif not ctx.halved:
        to_image = grad
    return to_image, to_faces, *[None] * 4


differentiable(nmr_gradient, _backward, _save)


# An edge p -> q of a counter-clockwise face with third corner r, and the scan lines that it crosses: rows for axis 0,
# which give the gradient of x, and columns for axis 1. Line u runs along v, in pixel units from the bottom left.
_EDGE = """
struct Edge {
    typedef wp::vec_t<3, float> vec3;
    int count, length;  // number and length of the lines
    int outward;  // direction along v out of the face: 1 or -1
    float pu, qu, ru, pv, qv, rv, slope;
    bool placed, bounded;

    static CUDA_CALLABLE float to_pixels(float x, int size) { return 0.5f * ((float)size * x + (float)(size - 1)); }
    static CUDA_CALLABLE float between(float low, float x, float high) { return x > low ? (x < high ? x : high) : low; }

    CUDA_CALLABLE Edge(const vec3& p, const vec3& q, const vec3& r, int axis, int height, int width) {
        count = axis == 0 ? height : width, length = axis == 0 ? width : height;
        pu = to_pixels(p[1 - axis], count), qu = to_pixels(q[1 - axis], count), ru = to_pixels(r[1 - axis], count);
        pv = to_pixels(p[axis], length), qv = to_pixels(q[axis], length), rv = to_pixels(r[axis], length);
        outward = (pu < qu) == (axis == 1) ? -1 : 1;
        slope = (qv - pv) / (qu - pu);
        // An edge with an end behind the camera gets no gradient, because this end has no projection.
        placed = !(fabsf(pu - qu) < SHORTEST || p[2] <= 0.0f || q[2] <= 0.0f);
        bounded = !(r[2] <= 0.0f);
    }
    CUDA_CALLABLE int first_line() const {
        return (int)ceilf(between(0.0f, pu < qu ? pu : qu, (float)count));
    }
    CUDA_CALLABLE int last_line() const {
        return (int)floorf(between(-1.0f, pu < qu ? qu : pu, (float)(count - 1)));
    }
    // Computed from the nearer end, so that it is exact at both ends.
    CUDA_CALLABLE float crossing(int u) const {
        const float from_p = (float)u - pu, from_q = (float)u - qu;
        const float c = fabsf(from_p) < fabsf(from_q) ? pv + slope * from_p : qv + slope * from_q;
        return between(-2.0f, c, (float)length + 1.0f);
    }
    CUDA_CALLABLE int inside_of(float crossing) const {
        return (int)(outward > 0 ? floorf(crossing) : ceilf(crossing));
    }
    // The last pixel before the line leaves the face through p-r or q-r; the image's last if r is behind the camera.
    CUDA_CALLABLE int far_side(int line) const {
        const float u = (float)line;
        float limit = rv;
        if (!bounded) limit = outward > 0 ? 0.0f : (float)length;
        else if ((pu < u && u < ru) || (ru < u && u < pu)) limit = pv + (rv - pv) * (u - pu) / (ru - pu);
        else if (qu != ru) limit = qv + (rv - qv) * (u - qu) / (ru - qu);
        limit = between(0.0f, limit, (float)(length - 1));
        return (int)(outward > 0 ? ceilf(limit) : floorf(limit));
    }
};
""".replace("SHORTEST", f"{SHORTEST!r}f")

_PULL = (
    (
        SCAN_LINE
        + _EDGE
        + """
    const int height = face_index.shape[1], width = face_index.shape[2];
    const Edge edge(p, q, r, axis, height, width);
    if (!edge.placed) return wp::vec_t<2, float>(0.0f);
    const int way = edge.outward;
    const bool binary = image.shape[0] == 0;
    const wp::int64 area = (wp::int64)height * width, planes = lines.shape[2], plane = lines.shape[3];
    const int* shown = face_index.data + b * area;
    const float* colors = image.data + b * image.shape[1] * area;
    // Strides in memory from one pixel of a line to the next, and from one line to the next. Row 0 is at the top.
    const int along = axis == 0 ? 1 : -width, across = axis == 0 ? -width : 1;
    ScanLine line;
    line.plane = plane, line.area = area, line.channels = (int)planes - 1;
    line.reach = fabsf(edge.qu - edge.pu) * 2.0f / (float)edge.length;
    line.to_p = line.to_q = 0.0f, line.also_to_p = line.also_to_q = 0.0f;
    #if defined(__CUDA_ARCH__)
    line.lane = lane, line.lanes = lanes;
    #endif
    for (int u = edge.first_line() + part, last = edge.last_line(); u <= last; u += parts) {
        const float c = edge.crossing(u);
        const int inner = edge.inside_of(c), outer = inner + way;
        if ((inner < outer ? inner : outer) < 0 || (inner < outer ? outer : inner) >= edge.length) continue;
        const wp::int64 inside = (wp::int64)(height - 1) * width + (wp::int64)u * across + (wp::int64)inner * along;
        const wp::int64 outside = inside + way * along;
        const bool visible = shown[inside] == f, facing = !(binary && shown[outside] >= 0);
        if (!visible && !facing) continue;
        // The edge reaches a pixel at the distance x on this line if p travels reach * x / share_p, or q likewise, in
        // screen units. The gradient of p is gain / (travel + eps), here expanded by share_p, which may be 0: a line
        // through one corner is moved by that corner alone.
        const float share_p = fabsf(edge.qu - (float)u), share_q = fabsf((float)u - edge.pu);
        line.slack_p = eps * share_p + TINY, line.slack_q = eps * share_q + TINY;
        line.share_p = -(float)way * share_p, line.share_q = -(float)way * share_q;
        line.stored = lines.data + ((wp::int64)b * edge.count + u) * planes * plane + WIDE;
        if (visible) {  // outward, to the end of the line's span
            const wp::vec_t<2, int> span = spans.data[(wp::int64)b * (height + width) + (axis == 0 ? u : height + u)];
            const int low = edge.length - span[0], high = span[1] - 1;
            const int begin = way > 0 ? (low > outer ? low : outer) : (high < outer ? high : outer);
            const int pixels = way > 0 ? high - begin + 1 : begin - low + 1;
            if (pixels > 0) {
                line.color = binary ? line.stored : colors + inside;
                line.outward(begin, way, pixels, fabsf((float)begin - c));
            }
        }
        if (facing) {
            const int pixels = (inner - edge.far_side(u)) * way + 1;
            if (pixels > 0) {
                line.color = binary ? line.stored : colors + outside;
                line.share_p = -line.share_p, line.share_q = -line.share_q;
                line.inward(inner, -way, pixels, fabsf((float)inner - c), f, shown + inside, -way * along);
            }
        }
    }
    return wp::vec_t<2, float>(
        ScanLine::total(line.to_p) + line.also_to_p, ScanLine::total(line.to_q) + line.also_to_q);
"""
    )
    .replace("TINY", f"{TINY!r}f")
    .replace("WIDE", str(WIDE))
)


@wp.func_native(_PULL)
def pull_edge(
    b: int,
    f: int,
    axis: int,
    lane: int,
    lanes: int,
    part: int,
    parts: int,
    p: wp.vec3,
    q: wp.vec3,
    r: wp.vec3,
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    lines: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    eps: float,
) -> wp.vec2:
    """Compute the gradient of the edge p -> q to p and q.

    With several parts only from every n-th of its lines, and with several lanes from every n-th pixel of them.
    """
    ...


@wp.func
def pull_face(
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    eps: float,
    result: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    lane: int,
    lanes: int,
    part: int,
    parts: int,
    alone: int,
):
    """Pull the edges of one face, along every n-th pixel of every n-th scan line; see `pull_edge`."""
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
        to_x = pull_edge(b, f, 0, lane, lanes, part, parts, p, q, r, image, face_index, rows, spans, eps)
        to_y = pull_edge(b, f, 1, lane, lanes, part, parts, p, q, r, image, face_index, columns, spans, eps)
        x[k] += to_x[0]
        y[k] += to_y[0]
        x[(k + 1) % 3] += to_x[1]
        y[(k + 1) % 3] += to_y[1]
    for k in range(3):
        corner = k
        if turned:
            corner = 2 - k
        to = wp.vec3(x[k], y[k], 0.0)
        if alone == 1:
            result[b, f, corner] = to
        else:
            wp.atomic_add(result, b, f, corner, to)


@wp.kernel(launch_bounds=(256, 2))
def _pull(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    rows: wp.array4d(dtype=float),
    columns: wp.array4d(dtype=float),
    spans: wp.array2d(dtype=wp.vec2i),
    visible: wp.array2d(dtype=int),
    eps: float,
    result: wp.array3d(dtype=wp.vec3),
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    lanes: int,
    threads: int,
):
    """Move the edges of a visible face of one image, or some pixels of some lines of them; see `launch_lines`."""
    thread = wp.int64(first + wp.tid())
    end = thread + wp.int64(1)
    alone = int(threads == 0)
    if threads > 0:
        end = queued_threads(total)
    elif visible[int(thread) // faces.shape[1], int(thread) % faces.shape[1]] == 0:
        return
    while thread < end:
        face, lane, part, parts = line_task(
            faces, face_index.shape[1], face_index.shape[2], queue, total, lanes, thread, int(_MOST)
        )
        b = face // faces.shape[1]
        f = face % faces.shape[1]
        pull_face(faces, image, face_index, rows, columns, spans, eps, result, b, f, lane, lanes, part, parts, alone)
        thread += wp.int64(wp.max(threads, 1))
