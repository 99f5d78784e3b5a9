"""The paper's approximate gradient through visibility, as an operation on an image (paper, sections 3.2 and 3.3).

The forward pass is the identity. The backward pass imagines that an edge of a visible face moves along a row or column
until it reaches a pixel, which then changes its colour. If this lowers the loss (to first order, by the pixel's
gradient), each corner of the edge gets a gradient: the decrease of the loss, divided by the distance that the corner
travels, summed over all pixels of the line. The gradient depends only on the image, not on how it was shaded.

The formulas are in `raster/kernels/nmr.h`, with the numbers of the paper's equations.

Source: Kato, Ushiku and Harada, "Neural 3D Mesh Renderer", CVPR 2018, section 3.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Optional

import torch
from torch import Tensor

from ..colors.downsample import averaged, change_averaged, halve_backward, like_averaged
from ..ops.visible_faces import scene_of, visible_faces
from ..warp.elementwise import any_of
from ..warp.launch import launch
from ..warp.layout import (
    concurrent,
    empty_queue,
    face_tasks,
    in_any_order,
    line_threads,
    pixel_tasks,
    queue_of,
    worth_a_thread,
)
from ..warp.memory import contiguous, empty, zeros
from ..warp.native import Call, Kernels, constant
from ..warp.registration import differentiable, differentiable_once, fake, operator

_KERNELS = Kernels(__name__, "nmr.h")
_ScanLines, _StoreLines, _NmrBackward = (_KERNELS.struct(name) for name in ("ScanLines", "StoreLines", "NmrBackward"))
_store_lines = _KERNELS.kernel("store_lines", _StoreLines)
_store_pixels = _KERNELS.kernel("store_pixels", _StoreLines, only_cuda=True)
_nmr_backward = _KERNELS.kernel("nmr_backward", _NmrBackward, launch_bounds=(256, 2))

PADDING, _LANES = constant("nmr.h", "PADDING"), constant("nmr.h", "LINE_LANES")
# Most bytes of stored scan lines; on the CPU about the size of its caches.
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
    difference of sums. ``eps`` is added to every distance, in screen units, and bounds the gradient of pixels that
    touch the edge. Other arguments, and the result, are as in `edge_gradient`; the silhouette is only faster.
    """
    return averaged(image, face_index, halved)


@fake(nmr_gradient)
def _(image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
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
    """Compute the gradients of `nmr_gradient` to faces and to the image; ``grad`` is as in `edge_gradient_backward`.

    Returns:
        To faces, [B, F, 3, 3], with 0 for z. To the image, [B, C, H, W]; empty if it is ``grad`` itself, or for None.
    """
    grad, faces = contiguous(grad), contiguous(faces)
    batch, height, width = face_index.shape
    device = faces.device
    result, to_image = zeros(faces.shape, device), grad.new_empty((0, 0, 0, 0))
    blocks = image is not None and grad.shape[2] < height
    if image is not None and blocks and concurrent(device) and grad.numel() and result.numel():
        to_image = empty(image.shape, device)  # written by `store_lines`
    elif blocks:
        to_image = grad = halve_backward(grad)
    if result.numel() == 0 or grad.numel() == 0:
        return result, to_image

    planes = 1
    if image is not None:
        image, channels = contiguous(image), image.shape[1]
        # The last channels, such as an unused alpha, may have no gradient. On a GPU this test would synchronise.
        while not (concurrent(device) or channels == 1 or any_of(grad[:, channels - 1])):
            channels -= 1
        planes = 1 + channels
    room = _ROOM_CONCURRENT if concurrent(device) else _ROOM
    chunk = max(1, min(batch, room // (8 * planes * height * width)))
    lines = empty_lines(chunk, height, width, planes, device)
    visible = None if in_any_order(device) else visible_faces(face_index, faces.shape[1])
    for first in range(0, batch, chunk):
        here = slice(first, first + chunk)
        scene, colors = scene_of(faces[here], face_index[here]), None if image is None else image[here]
        stored, queue = store_lines(scene, colors, grad[here], lines, to_image[here] if blocks else None)
        least, threads = face_tasks(faces, height * width), line_threads(scene.images * scene.count, queue, _LANES)
        call = _NmrBackward(
            scene=scene,
            image=colors,
            channels=grad.shape[1],
            lines=stored,
            visible=None if visible is None else visible[here],
            queue=queue_of(queue, threads),
            eps=max(eps, 1e-12),  # 0 would divide by zero at a pixel that touches the edge
            to_faces=result[here],
        )
        launch(_nmr_backward, threads, [call], device, least)
    return result, to_image


class Lines(NamedTuple):
    """Memory of scan lines; see `ScanLines` in `nmr.h`."""

    rows: Tensor  # [images, height, planes, PADDING + width] float32
    columns: Tensor  # [images, width, planes, PADDING + height] float32
    spans: Tensor  # [images, height + width, 2] int32


def empty_lines(images: int, height: int, width: int, planes: int, device: torch.device) -> Lines:
    """Allocate scan lines of any contents, with zeros after the last one."""

    def axis(count: int, length: int) -> Tensor:
        shape = (images, count, planes, PADDING + length)
        room = empty((math.prod(shape) + PADDING,), device)
        if not concurrent(device):
            room[-PADDING:] = 0
        return room[:-PADDING].view(shape)

    spans = torch.empty((images, height + width, 2), dtype=torch.int32, device=device)
    return Lines(axis(height, width), axis(width, height), spans)


def store_lines(
    scene: Call, image: Tensor | None, grad: Tensor, lines: Lines, spread: Tensor | None = None
) -> tuple[Call, tuple[Tensor, Tensor] | None]:
    """Store the scan lines of a scene in ``lines``, as from `empty_lines`; others as in `nmr_gradient_backward`.

    ``spread`` gets the gradient of each pixel of an image if ``grad`` is that to means of blocks, on CUDA. Returns the
    `ScanLines` of kernels, and the queue of visible faces on CUDA; None where each face has one task.
    """
    images, height, width, device = scene.images, scene.height, scene.width, grad.device
    fields: dict[str, Any] = {
        "scene": scene,
        "image": image,
        "grad": grad,
        "channels": grad.shape[1],
        "halved": int(grad.shape[3] < width),
    }
    spans, planes = lines.spans, lines.rows.shape[2]
    if not concurrent(device):
        stored = _ScanLines(rows=lines.rows, columns=lines.columns, spans=spans, planes=planes)
        tasks = images * (-(-height // PADDING) - (-width // PADDING))
        launch(_store_lines, tasks, [_StoreLines(lines=stored, **fields)], device, worth_a_thread(PADDING * width))
        return stored, None
    # The total of the queue, the faces in it, and the spans share one allocation, which one launch clears.
    faces = images * scene.count if in_any_order(device) else 0
    sizes = (2, faces, images * (height + width) * 2)
    total, queued, spans = zeros((sum(sizes),), device, torch.int32).split(sizes)
    queue = (empty_queue(faces, device)[0], total.view(torch.int64)) if in_any_order(device) else None
    stored = _ScanLines(rows=lines.rows, columns=lines.columns, spans=spans, planes=planes)
    tasks, each = pixel_tasks(images * height, width, device)
    filled = {"queued": queued, "queue": queue_of(queue)} if queue else {}
    launch(_store_pixels, tasks, [_StoreLines(lines=stored, each=each, spread=spread, **fields, **filled)], device)
    return stored, queue


@fake(nmr_gradient_backward)
def _(grad: Tensor, image: Tensor | None, faces: Tensor, face_index: Tensor) -> tuple[Tensor, Tensor]:
    blocks = image is not None and grad.shape[2] < face_index.shape[1]
    to_image = grad.new_empty((0, 0, 0, 0) if image is None or not blocks else image.shape)
    return torch.empty_like(faces, memory_format=torch.contiguous_format), to_image


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    image, faces, face_index, ctx.eps, ctx.two_sided, ctx.halved = inputs
    ctx.save_for_backward(image, faces, face_index)  # not the output, which callers may change in place


def _backward(ctx: Any, grad: Tensor) -> Any:
    image, faces, face_index = ctx.saved_tensors
    grad = contiguous(grad)  # one copy, which earlier operators need as well
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


def _refuse(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    if tangents[1] is not None:
        raise RuntimeError(
            'gradient="nmr": expected no motion to differentiate in forward mode, got a tangent of vertices; '
            'the paper\'s estimate depends on the loss and is no linear map of motions (use gradient="edge")'
        )
    return change_averaged(tangents[0], inputs[-1])


differentiable(nmr_gradient, _backward, _save, _refuse)
