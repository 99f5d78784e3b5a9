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
  has the weight 1 / c. If the surface continues, the next faces stand in for a missed one.
- Where two surfaces meet at an edge, as at a T-junction, each edge has half of the gain.
- Seams, where two faces of a surface meet in different colours, take both colours from pixels that show them.

The formulas are in `raster/kernels/edge.h`, on `crossings.h`.

Where two faces intersect, the visible boundary is the line of equal depth; see `intersections`.

An estimate is the derivative of pixels averaged over shifts along the motion. Its mean over shifts averages again, so
the weights dL/dI count as if interpolated linearly along the motion. No estimate from one image avoids it: a mean is
continuous in the place of the boundary, but the weight of the pixel that contains the boundary jumps.

Pitfalls. Otherwise the mean is exact, with these exceptions: colours that curve within a pixel; gaps narrower than a
pixel between two boundaries; boundaries along the border of the image, closer than a pixel; intersections where the
visible parts of both faces are narrow; chords shorter than `LEAST_CHORD`, whose colour has a part of its gradient only;
edges with an end behind the camera, which get no gradient. Seams of triangles of half a pixel to two pixels are right
within 3 %, but noisy; a seam is lost if no pixel near the middle of one of its faces shows that face.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
from collections.abc import Sequence
from typing import Any, Optional

import torch
from torch import Tensor

from ..colors.downsample import averaged, change_averaged, changes_averaged, like_averaged, spread, whole
from ..colors.texture_cubes import lit_cubes
from ..ops.neighbors import Neighbors, neighbors, rings_of
from ..ops.rings import Rings, count_alone
from ..ops.visible_faces import scene_of, visible_faces
from ..warp.launch import launch
from ..warp.layout import cpu_bands, face_tasks, in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.queue import MOST_THREADS, empty_queue, line_threads, queue_of
from ..warp.registration import differentiable, differentiable_once, fake, forward_operator, in_direction, operator
from .intersections import add_intersections, pictures_of, push_intersections

_KERNELS, _FORWARD = Kernels(__name__, "edge.h"), Kernels(__name__ + ".forward", "edge.h")
_EdgeHashes, _Edges = _KERNELS.struct("EdgeHashes"), _KERNELS.struct("Edges")
_EdgeBackward, _EdgeForward = _KERNELS.struct("EdgeBackward"), _KERNELS.struct("EdgeForward")
_edge_backward = _KERNELS.kernel("edge_backward", _EdgeBackward, launch_bounds=(256, 2))
_queue_moving_face = _KERNELS.kernel("queue_moving_face", _Edges, only_cuda=True)
_find_moving_edges = _FORWARD.kernel("find_moving_edges", _EdgeForward)
_edge_forward = _FORWARD.kernel("edge_forward", _EdgeForward, launch_bounds=(256, 2))

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
    alone: int = -1,
    below: int = 0,
    above: int = 0,
    textures: Optional[Tensor] = None,  # noqa: UP045
    light: Optional[Tensor] = None,  # noqa: UP045
    firsts: Optional[Tensor] = None,  # noqa: UP045
) -> Tensor:
    """Return the image, and in backward send a gradient through visibility to the faces.

    Args:
        image: Any number of channels with their background, before anti-aliasing, [B, C, H, W] float32. None stands for
            the silhouette, of one channel.
        faces, two_sided, perspective, below, above: As in `coverage`, which finds the ``face_index``.
        seams: Whether colours may jump between adjacent faces of a surface, as with texture cubes and flat shading. If
            False, edges between adjacent faces have no gradient, which is right, and less noisy, for interpolated
            colours.
        edge_hashes: [1 or B, F, 3, 2] int64 from `texture_edge_hashes` or `image_edge_hashes`. An edge whose hashes
            match is not a seam. None: every edge may be a seam, or `textures` tell.
        rings, alone: `Rings` for the vertex indices of the faces, which replace the search for adjacent faces.
        halved: Whether to average blocks of 2 x 2 pixels (anti-aliasing), which saves a copy of the image.
        textures, light, firsts: Instead of hashes, what `texture_edge_hashes` would hash; not on CUDA.

    Returns:
        A copy of the image, [B, C, H, W] float32, or [B, C, H / 2, W / 2] if ``halved``. Backward sends its gradient to
        the image, and gradients to x and y of faces; where faces intersect, also to z. There is no second derivative
        (RuntimeError).
    """
    return averaged(None if image is None else whole(image), face_index, halved)


@fake(edge_gradient)
def _(image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
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
    alone: int = -1,
    below: int = 0,
    above: int = 0,
    textures: Optional[Tensor] = None,  # noqa: UP045
    light: Optional[Tensor] = None,  # noqa: UP045
    firsts: Optional[Tensor] = None,  # noqa: UP045
) -> Tensor:
    """Compute the gradient [B, F, 3, 3] float32 that `edge_gradient` sends to its faces; arguments as there.

    ``grad`` is the gradient to the image, or to the means of its blocks of 2 x 2 pixels, [B, C, H / 2, W / 2].
    """
    grad, faces = grad.contiguous(), faces.contiguous()
    result = zeros(faces.shape, faces.device)
    if result.numel() == 0 or grad.numel() == 0:
        return result
    adjacent, search = _adjacent(faces, two_sided, perspective, rings, alone)
    strip = (below, above)
    cubes = None if textures is None or light is None else lit_cubes(textures, light, firsts=firsts)
    edges = Edges(image, grad, faces, face_index, adjacent, perspective, seams, edge_hashes, None, search, strip, cubes)
    edges.add_gradient(result)
    if image is not None:  # where two faces of a silhouette meet, both are 1
        add_intersections(result, grad, image, faces, face_index, adjacent, perspective, *strip)
    return result


@fake(edge_gradient_backward)
def _(faces: Tensor) -> Tensor:
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


@forward_operator(2)
def edge_gradient_forward(
    to_image: Optional[Tensor],  # noqa: UP045
    motion: Tensor,
    image: Optional[Tensor],  # noqa: UP045
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045
    rings: Optional[Tensor] = None,  # noqa: UP045
    halved: bool = False,
    alone: int = -1,
    below: int = 0,
    above: int = 0,
    textures: Optional[Tensor] = None,  # noqa: UP045
    light: Optional[Tensor] = None,  # noqa: UP045
    firsts: Optional[Tensor] = None,  # noqa: UP045
) -> Tensor:
    """Compute the change of `edge_gradient` in T directions, [T, B, C, H, W] or halved; the transpose of its backward.

    The change of the image, [T, B, C, H, W] float32, or None for 0, and the motion of the faces, [T, B, F, 3, 3]
    float32, come first; others are as in `edge_gradient`.
    """
    faces, motion = faces.contiguous(), motion.contiguous()
    result = changes_averaged(to_image, len(motion), image, face_index, halved)
    if motion.numel() == 0 or result.numel() == 0:
        return result
    adjacent, search = _adjacent(faces, two_sided, perspective, rings, alone)
    strip = (below, above)
    cubes = None if textures is None or light is None else lit_cubes(textures, light, firsts=firsts)
    fields = (adjacent, perspective, seams, edge_hashes, None, search, strip, cubes)
    edges = Edges(image, result[0], faces, face_index, *fields)
    edges.push(result, motion)
    if image is not None:
        push_intersections(result, motion, image, faces, face_index, adjacent, perspective, *strip)
    return result


@fake(edge_gradient_forward)
def _(motion: Tensor, image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
    one = like_averaged(image, face_index, halved)
    return one.new_empty((len(motion), *one.shape))


def _adjacent(
    faces: Tensor, two_sided: bool, perspective: bool, rings: Tensor | None, alone: int
) -> tuple[Tensor, tuple[Rings, bool] | None]:
    """Find the adjacent faces; or make memory for them, and what the launch that queues faces needs to find them."""
    known = None if rings is None else Rings(rings, alone)
    if known and in_any_order(faces.device) and count_alone(known) == 0:
        return empty((*faces.shape[:2], 3), faces.device, torch.int32), (known, two_sided)
    return neighbors(faces, two_sided, perspective, known), None


class Edges:
    """The outlines and seams of images, for both modes of differentiation.

    Args:
        image, faces, face_index, perspective, seams, edge_hashes: As in `edge_gradient`.
        grad: Gradient as in `edge_gradient_backward`; in forward mode any map of its shape.
        adjacent: As from `neighbors`.
        folds: Faces that the surface folds back to, as from `neighbors`; where a surface folds, only the front
            face receives the gradient. None: edges behind folds are hidden anyway.
        search: On CUDA, rings without edges that are alone, and ``two_sided``, to find ``adjacent``, which is written.
        strip: Rows of a whole image below and above this strip of it.
        cubes: Instead of hashes, the `LitCubes` whose colours are compared; on the CPU.
    """

    def __init__(
        self,
        image: Tensor | None,
        grad: Tensor,
        faces: Tensor,
        face_index: Tensor,
        adjacent: Tensor,
        perspective: bool,
        seams: bool,
        edge_hashes: Tensor | None,
        folds: Tensor | None = None,
        search: tuple[Rings, bool] | None = None,
        strip: tuple[int, int] = (0, 0),
        cubes: Call | None = None,
    ) -> None:
        batch, height, width = face_index.shape
        self._faces, self._lines, device = faces, (height, width), faces.device
        if edge_hashes is None and cubes is None and seams:
            edge_hashes = torch.zeros((1, 1, 3, 2), dtype=torch.int64, device=device)  # 0 matches nothing
        scene = scene_of(faces, face_index, perspective, *strip)
        rings, two_sided = search or (None, False)
        searched = Neighbors(
            scene=scene, two_sided=int(two_sided), way=-1, rings=rings_of(rings), adjacent=adjacent.contiguous()
        )
        self._pictures = pictures_of(image, grad, width)
        fields: dict[str, Any] = {
            "scene": scene,
            "pictures": self._pictures,
            "neighbors": searched,
            "folds": folds,
            "visible": visible_faces(face_index, faces.shape[1]),
            "seams": int(seams),
            "textures": cubes,
        }
        if edge_hashes is not None:
            images, hashed = edge_hashes.shape[:2]
            fields["edge_hashes"] = _EdgeHashes(values=edge_hashes.contiguous(), images=images, count=hashed)
        count = batch * faces.shape[1]
        queue = empty_queue(count, device) if in_any_order(device) else None
        if queue is not None:
            launch(_queue_moving_face, count, [_Edges(queue=queue_of(queue), **fields)], device)
        # A scan line crosses a few outlines, and any number of seams.
        most = MOST_THREADS if seams else _OUTLINES_OF_LINE * batch * (height + width)
        self._threads = line_threads(count, queue, 1, most)
        self._call = _Edges(queue=queue_of(queue, self._threads), **fields)

    def add_gradient(self, to_faces: Tensor) -> None:
        """Compute the gradient to the corners, [B, F, 3, 3] float32 of zeros; written."""
        call = _EdgeBackward(edges=self._call, to_faces=to_faces)
        height, width = self._lines
        launch(_edge_backward, self._threads, [call], to_faces.device, face_tasks(to_faces, height * width))

    def push(self, images: Tensor, motion: Tensor) -> None:
        """Add the change to images [T, B, C, H, W] float32, or halved ones, for motions [T, B, F, 3, 3] of corners."""
        device, (batch, count) = images.device, self._faces.shape[:2]
        fields = {"edges": self._call, "motion": motion, "directions": len(motion), "images": images}
        if in_any_order(device):
            launch(_edge_forward, self._threads, [_EdgeForward(**fields)], device)
            return
        fields["moving"] = torch.empty((batch, count), dtype=torch.uint8, device=device)
        least = face_tasks(self._faces, self._lines[0] * self._lines[1])
        launch(_find_moving_edges, batch * count, [_EdgeForward(**fields)], device, least)
        for axis, lines in enumerate(self._lines):  # one after the other, because their lines cross
            band = 2 * -(-lines // (2 * cpu_bands(batch, lines * self._lines[1 - axis] + 32 * count)))  # whole blocks
            call = _EdgeForward(axis=axis, band=band, **fields)
            launch(_edge_forward, batch * -(-lines // band), [call], device)


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    image, faces, face_index, *rest = inputs
    ctx.options, ctx.strip = rest[:3], rest[7:9]
    edge_hashes, rings, ctx.halved, ctx.alone = rest[3:7]
    ctx.save_for_backward(image, faces, face_index, edge_hashes, rings, *rest[9:])  # callers may change the output


def _backward(ctx: Any, grad: Tensor) -> Any:
    image, faces, face_index, edge_hashes, rings, *cubes = ctx.saved_tensors
    to_image = to_faces = None
    if image is not None:
        to_image, image = spread(grad, image) if ctx.halved else grad, whole(image)
    if ctx.needs_input_grad[1]:
        options = (*ctx.options, edge_hashes, rings, ctx.alone, *ctx.strip, *cubes)
        to_faces = edge_gradient_backward(grad, image, faces, face_index, *options)
    return to_image, to_faces, *[None] * 13


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    to_image, motion = tangents[:2]
    if motion is None:
        halved = inputs[8]
        return change_averaged(to_image, halved)
    return in_direction(edge_gradient_forward, (to_image, motion), *inputs)


differentiable(edge_gradient, _backward, _save, _forward)
