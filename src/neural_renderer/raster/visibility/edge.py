"""The derivative of an image through visibility: the estimator `gradient="edge"`.

Maths. An image I jumps when corners move, but its average over sub-pixel shifts of the pixel grid is a smooth function
of the corners. The derivative of the average has two parts (Li, Aittala, Durand and Lehtinen, "Differentiable Monte
Carlo ray tracing through edge sampling", 2018; Reynolds' transport theorem). The operators of colour and depth compute
the first part, the derivative of the colours inside faces. This module computes the second part, an integral along the
visible boundaries. A moving boundary sweeps over area, and the colour there changes from the outer to the inner one:

    dL = integral along the boundary of (outward motion) * sum over channels of (I_inner - I_outer) * dL/dI.

Rows and columns of pixel centres sample the integral. A row that crosses an edge p -> q at the share s from p to q
measures the motion (1 - s) dp_x + s dq_x along x; a column measures the motion along y. A crossing counts if the pixel
on its inner side shows the face and the pixel on its outer side shows a farther face or the background:

- Each of the two colours is extrapolated linearly to the crossing if the next pixel shows the same face.
- dL/dI is the gradient of the pixel that contains the crossing.
- A pixel centre hits a face whose chord c on the line is shorter than a pixel with probability c only, so the crossing
  has the weight 1 / c. If the surface continues, the next faces stand in for a missed one; see `outlines`.
- Where two surfaces meet at an edge, as at a T-junction, each edge has half of the gain.
- Seams, where two faces of a surface meet in different colours, are in `seams`.

Where two faces intersect, the visible boundary is the line of equal depth; see `intersections`.

Pitfalls. The mean of the estimate over sub-pixel shifts is exact, with these exceptions: colours that curve within a
pixel; gaps narrower than a pixel between two boundaries; boundaries along the border of the image, closer than a pixel;
the last pixel at each end of an intersection; edges with an end behind the camera, which get no gradient. Seams of
triangles of half a pixel to two pixels are right within 3 %, but noisy.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
from typing import Optional

import torch
import warp as wp
from torch import Tensor

from ..colors.downsample import averaged, halve_backward, like_averaged
from ..ops.visible_faces import visible_faces
from ..warp.geometry import facing
from ..warp.launch import array, launch, module_for_cuda, optional_array
from ..warp.layout import face_tasks, in_any_order
from ..warp.memory import empty, zeros
from ..warp.point import fill
from ..warp.queue import MOST_THREADS, enqueue_lines, launch_lines, line_queue, line_task, queue_arrays, queued_threads
from ..warp.registration import differentiable, differentiable_once, operator
from .continuity import colors_continue
from .crossings import CROSSINGS
from .gains import GAINS
from .intersections import add_intersections
from .nearness import NEARNESS
from .neighbors import neighbors, search_rings
from .outlines import LONGEST, OUTLINES
from .rings import edges_alone
from .seams import SEAMS

wp.set_module_options({"enable_backward": False})

_MOST = wp.constant(1)  # scan lines of a CUDA thread
_OUTLINES_OF_LINE = 8  # CUDA threads for the outlines that a scan line crosses; more outlines take turns


@operator
def edge_gradient(
    image: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045
    rings: Optional[Tensor] = None,  # noqa: UP045
    halved: bool = False,
) -> Tensor:
    """Return the image, and in backward send a gradient through visibility to the faces.

    Args:
        image: Any number of channels with their background, before anti-aliasing, [B, C, H, W] float32. None stands for
            the silhouette, of one channel.
        faces: Screen-space corners, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32, as from `coverage`.
        two_sided: As in `coverage`.
        perspective: As in `coverage`.
        seams: Whether colours may jump between adjacent faces of a surface, as with texture cubes and flat shading. If
            False, edges between adjacent faces have no gradient, which is right, and less noisy, for interpolated
            colours.
        edge_hashes: [1 or B, F, 3, 2] int64 from `texture_edge_hashes` or `image_edge_hashes`. An edge whose hashes
            match is not a seam. None: every edge may be a seam.
        rings: [1 or B, F + 1, 3] int32 from `edge_rings` for the vertex indices of the faces. They replace the search
            for adjacent faces; None searches.
        halved: Whether to average blocks of 2 x 2 pixels (anti-aliasing), which saves a copy of the image.

    Returns:
        A copy of the image, [B, C, H, W] float32, or [B, C, H / 2, W / 2] if ``halved``. Backward sends its gradient to
        the image, and gradients to x and y of faces; where faces intersect, also to z. There is no second derivative
        (RuntimeError).
    """
    return averaged(image, face_index, halved)


@torch.library.register_fake("neural_renderer::edge_gradient")
def _(image, faces, face_index, two_sided, perspective, seams, edge_hashes=None, rings=None, halved=False):
    return like_averaged(image, face_index, halved)


@differentiable_once
def edge_gradient_backward(
    grad: Tensor,
    image: Optional[Tensor],  # noqa: UP045
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045
    rings: Optional[Tensor] = None,  # noqa: UP045
) -> Tensor:
    """Compute the gradient [B, F, 3, 3] float32 that `edge_gradient` sends to its faces.

    Args:
        grad: Gradient to the image, [B, C, H, W] float32; or to the means of its blocks of 2 x 2 pixels,
            [B, C, H / 2, W / 2].
        image, faces, face_index, two_sided, perspective, seams, edge_hashes, rings: As in `edge_gradient`.
    """
    grad, faces = grad.contiguous(), faces.contiguous()
    result = zeros(faces.shape, faces.device)
    if result.numel() == 0 or grad.numel() == 0:
        return result
    search = None
    if rings is not None and in_any_order(faces.device) and edges_alone(rings) == 0:
        search = (rings, two_sided)  # by the launch that queues faces
        adjacent = empty((*faces.shape[:2], 3), faces.device, torch.int32)
    else:
        adjacent = neighbors(faces, two_sided, perspective, rings)
    add_edges(result, grad, image, faces, face_index, adjacent, perspective, seams, edge_hashes, search=search)
    if image is not None:  # where two faces of a silhouette meet, both are 1
        add_intersections(result, grad, image, faces, face_index, adjacent, perspective)
    return result


def add_edges(
    result: Tensor,
    grad: Tensor,
    image: Tensor | None,
    faces: Tensor,
    face_index: Tensor,
    adjacent: Tensor,
    perspective: bool,
    seams: bool,
    edge_hashes: Tensor | None,
    folds: Tensor | None = None,
    search: tuple[Tensor, bool] | None = None,
) -> None:
    """Compute the gradient of outlines and seams.

    Args:
        result: Gradient to the corners, [B, F, 3, 3] float32 of zeros; written.
        grad: As in `edge_gradient_backward`.
        image: [B, C, H, W] float32; None for the silhouette.
        faces, face_index, perspective, seams, edge_hashes: As in `edge_gradient`.
        adjacent: As from `neighbors`.
        folds: Faces that the surface folds back to, as from `neighbors`; an edge behind its fold has no gradient, for
            the face in front has it. None: edges behind folds are hidden anyway.
        search: On CUDA, rings without edges that are alone, and ``two_sided``, to find ``adjacent``, which is written.
    """
    batch, height, width = face_index.shape
    count, device = faces.shape[1], faces.device
    if edge_hashes is None and seams:
        edge_hashes = torch.zeros((1, 1, 3, 2), dtype=torch.int64, device=device)  # 0 matches nothing
    corners, beside = array(faces, wp.vec3), [array(visible_faces(face_index, count)), array(adjacent)]
    queue = line_queue(batch * count, device)
    if queue is not None:
        rings, two_sided = search or (None, False)
        known = [optional_array(rings, 3, device), int(two_sided), int(perspective)]
        filled = [int(seams), height, width, *queue_arrays(queue, device)]
        launch(_queue_faces, batch * count, [corners, *known, *beside, *filled], device)
    arguments = [corners, optional_array(image, 4, device), array(grad), array(face_index), *beside]
    arguments += [optional_array(folds, 3, device), int(perspective), int(seams)]
    arguments += [optional_array(edge_hashes, 4, device), array(result, wp.vec3)]
    # A scan line crosses a few outlines, and any number of seams.
    most = MOST_THREADS if seams else _OUTLINES_OF_LINE * batch * (height + width)
    launch_lines(_move, arguments, batch * count, queue, 1, device, face_tasks(faces, height * width), most)


@torch.library.register_fake("neural_renderer::edge_gradient_backward")
def _(grad, image, faces, face_index, two_sided, perspective, seams, edge_hashes=None, rings=None):
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


def _save(ctx, inputs, output):
    image, faces, face_index, ctx.two_sided, ctx.perspective, ctx.seams, edge_hashes, rings, ctx.halved = inputs
    ctx.save_for_backward(image, faces, face_index, edge_hashes, rings)  # callers may change the output in place


def _backward(ctx, grad):
    image, faces, face_index, *rest = ctx.saved_tensors
    to_image = to_faces = None
    if image is not None:
        to_image = grad = halve_backward(grad) if ctx.halved else grad
    if ctx.needs_input_grad[1]:
        options = (ctx.two_sided, ctx.perspective, ctx.seams, *rest)
        to_faces = edge_gradient_backward(grad, image, faces, face_index, *options)
    return to_image, to_faces, *[None] * 7


differentiable(edge_gradient, _backward, _save)


_MOVE_EDGES = """
    Lines lines;
    lines.height = face_index.shape[1], lines.width = face_index.shape[2], lines.channels = grad.shape[1];
    lines.is_silhouette = image.shape[0] == 0, lines.halved = grad.shape[3] < lines.width;
    lines.perspective = perspective;
    lines.set(0);
    const wp::int64 first_face = (wp::int64)b * faces.shape[1], own = first_face + f;
    lines.image = lines.is_silhouette ? grad.data : image.data + b * lines.channels * lines.area;
    lines.grad_area = lines.halved ? lines.area / 4 : lines.area;
    lines.grad = grad.data + b * lines.channels * lines.grad_area;
    lines.shown = face_index.data + b * lines.area;
    lines.faces = faces.data + first_face * 3;
    lines.adjacent = adjacent.data + first_face * 3;
    const vec3* corners = faces.data + own * 3;
    const int* next = adjacent.data + own * 3;
    vec3 to[3] = {vec3(0.0f), vec3(0.0f), vec3(0.0f)};
    for (int k = 0; k < 3; ++k) {
        if ((edges >> k & 1) == 0) continue;
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        const int p = clockwise ? m : k, q = clockwise ? k : m;  // counter-clockwise
        Edge edge;
        edge.face = f, edge.adjacent = next[k];
        edge.adjacent_pr = next[clockwise ? m : n], edge.adjacent_qr = next[clockwise ? n : m];
        edge.small = edge.adjacent >= 0 && (Seam::is_small(lines, f) || Seam::is_small(lines, edge.adjacent));
        for (int axis = 0; axis < 2; ++axis) {
            lines.set(axis);
            edge.set(lines, corners[p], corners[q], corners[n]);
            if (!edge.has_crossings(lines)) continue;
            float to_p = 0.0f, to_q = 0.0f;
            const int end = edge.end(lines);
            for (int u = edge.first(lines) + part; u < end; u += parts) {
                const Crossing at = edge.crossing(lines, u);
                if ((at.inner_face == -2) | (at.outer_face == -2) | (at.inner_face == at.outer_face)) continue;
                float gain = edge.adjacent >= 0 ? Seam::gain(lines, edge, at) : Outline::gain(lines, edge, at);
                gain *= Lines::border_weight(at.v, lines.length);
                to_p += (1.0f - at.share) * gain, to_q += at.share * gain;
            }
            // A pixel has a quarter of the gradient of its block.
            const float scale = (lines.halved ? 0.125f : 0.5f) * (float)(edge.outward * lines.length);
            to[p][axis] += scale * to_p, to[q][axis] += scale * to_q;
        }
    }
    for (int k = 0; k < 3; ++k) {
        if (alone) result.data[own * 3 + k] = to[k];
        else wp::atomic_add(result.data + own * 3 + k, to[k]);
    }
"""


@wp.func_native(CROSSINGS + GAINS + NEARNESS + OUTLINES + SEAMS + _MOVE_EDGES)
def move_edges(
    edges: int,
    clockwise: bool,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    adjacent: wp.array3d(dtype=int),
    perspective: int,
    b: int,
    f: int,
    part: int,
    parts: int,
    alone: int,
    result: wp.array3d(dtype=wp.vec3),
):
    """Move those edges of face f in image b whose bit is set in ``edges``, over every ``parts``-th scan line.

    ``alone`` means that no other task writes to the same places.
    """
    ...


_HAS_MOVING_EDGE = """
    const int* next = adjacent.data + (wp::int64)b * adjacent.shape[1] * 3;
    const int* shown = visible.data + (wp::int64)b * visible.shape[1];
    const bool has_outline = next[3 * f] < 0 || next[3 * f + 1] < 0 || next[3 * f + 2] < 0;
    if (shown[f]) return seams || has_outline;
    // The outline of a face that all pixel centres miss is visible if one of the faces behind it is; for a seam, the
    // adjacent face has to be. The search goes from face to face, depth first. Without it, the face may pass in vain.
    int faces[LONGEST + 2], from[LONGEST + 2], steps[LONGEST + 2], last = 0;
    faces[0] = f, from[0] = -1, steps[0] = has_outline ? LONGEST : seams ? 1 : 0;
    while (last >= 0) {
        const int face = faces[last], before = from[last], left = steps[last] - 1;
        --last;
        for (int k = 0; k < 3 && left >= 0; ++k) {
            const int g = next[3 * (wp::int64)face + k];
            if (g < 0 || g == before) continue;
            if (shown[g] || (has_outline && !search)) return true;
            if (left > 0) ++last, faces[last] = g, from[last] = face, steps[last] = left;
        }
    }
    return false;
"""


@wp.func_native(fill(_HAS_MOVING_EDGE, LONGEST=str(LONGEST)))
def has_moving_edge(
    visible: wp.array2d(dtype=int), adjacent: wp.array3d(dtype=int), b: int, f: int, seams: int, search: int
) -> bool:
    """Test whether an edge of the face may be a visible boundary; ``search``: among adjacent faces of faces, too."""
    ...


_FOLDS_BEHIND = """
    if (folds.shape[0] == 0) return false;
    const wp::int64 first_face = (wp::int64)b * faces.shape[1], own = first_face + f;
    const int other = folds.data[own * 3 + k];
    if (other < 0) return false;
    const auto* v = faces.data + (first_face + other) * 3;
    const auto r = faces.data[own * 3 + (k + 2) % 3];
    if (perspective && ((v[0][2] <= 0.0f) | (v[1][2] <= 0.0f) | (v[2][2] <= 0.0f) | (r[2] <= 0.0f))) return false;
    return Nearness::at(v, r[0], r[1], perspective) > Nearness::of(r[2], perspective);
"""


@wp.func_native(NEARNESS + _FOLDS_BEHIND)
def folds_behind(
    faces: wp.array3d(dtype=wp.vec3), folds: wp.array3d(dtype=int), b: int, f: int, k: int, perspective: int
) -> bool:
    """Test whether a surface folds at edge k of face f, and the other face of the fold is in front of f."""
    ...


@wp.func
def may_move(
    adjacent: wp.array3d(dtype=int),
    faces: wp.array3d(dtype=wp.vec3),
    edge_hashes: wp.array4d(dtype=wp.int64),
    b: int,
    f: int,
    k: int,
    seams: int,
    folds: wp.array3d(dtype=int),
    perspective: int,
) -> bool:
    """Test whether edge k of a face is an outline, or a seam to a face of higher index (each seam counts once)."""
    other = adjacent[b, f, k]
    if other < 0:
        return not folds_behind(faces, folds, b, f, k, perspective)
    if seams == 0 or other < f:
        return False
    return not colors_continue(edge_hashes, faces, adjacent, b, f, k)


@wp.func
def move_face(
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    adjacent: wp.array3d(dtype=int),
    folds: wp.array3d(dtype=int),
    perspective: int,
    seams: int,
    edge_hashes: wp.array4d(dtype=wp.int64),
    result: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    part: int,
    parts: int,
    alone: int,
):
    """Move the edges of one face, over every n-th scan line."""
    clockwise = facing(faces[b, f, 0], faces[b, f, 1], faces[b, f, 2], perspective) < 0
    edges = int(0)
    for k in range(3):
        if may_move(adjacent, faces, edge_hashes, b, f, k, seams, folds, perspective):
            edges += 1 << k
    move_edges(
        edges, clockwise, faces, image, grad, face_index, adjacent, perspective, b, f, part, parts, alone, result
    )


@wp.kernel(module=module_for_cuda(__name__))
def _queue_faces(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    rings: wp.array3d(dtype=int),
    two_sided: int,
    perspective: int,
    visible: wp.array2d(dtype=int),
    adjacent: wp.array3d(dtype=int),
    seams: int,
    height: int,
    width: int,
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
):
    """Put a face that may have an edge to move into the queue for `_move`. With rings, first find adjacent faces."""
    task = first + wp.tid()
    b = task // int(faces.shape[1])
    f = task % int(faces.shape[1])
    if rings.shape[0] > 0:
        search_rings(faces, rings, two_sided, perspective, -1, b, f, adjacent)
    if has_moving_edge(visible, adjacent, b, f, seams, 0):  # the search would keep a GPU's other threads waiting
        enqueue_lines(faces, b, f, height, width, queue, total, 1, int(_MOST))


@wp.kernel(launch_bounds=(256, 2))
def _move(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    visible: wp.array2d(dtype=int),
    adjacent: wp.array3d(dtype=int),
    folds: wp.array3d(dtype=int),
    perspective: int,
    seams: int,
    edge_hashes: wp.array4d(dtype=wp.int64),
    result: wp.array3d(dtype=wp.vec3),
    queue: wp.array2d(dtype=wp.int64),
    total: wp.array1d(dtype=wp.int64),
    lanes: int,
    threads: int,
):
    """Move the edges of one face of one image, or some lines of them; see `launch_lines`."""
    thread = wp.int64(first + wp.tid())
    end = thread + wp.int64(1)
    alone = int(threads == 0)
    if threads > 0:
        end = queued_threads(total)
    elif not has_moving_edge(visible, adjacent, int(thread) // faces.shape[1], int(thread) % faces.shape[1], seams, 1):
        return
    while thread < end:
        face, _lane, part, parts = line_task(
            faces, face_index.shape[1], face_index.shape[2], queue, total, lanes, thread, int(_MOST)
        )
        b = face // faces.shape[1]
        f = face % faces.shape[1]
        move_face(
            faces, image, grad, face_index, adjacent, folds, perspective, seams, edge_hashes, result, b, f, part,
            parts, alone,
        )  # fmt: skip
        thread += wp.int64(wp.max(threads, 1))
