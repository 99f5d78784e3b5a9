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

- Each of the two colours is extrapolated linearly to the crossing if the next pixel shows the same face. If the chord
  of the face is too short for that, weights by the place of the centre in the chord have the same mean.
- dL/dI is the gradient of the pixel that contains the crossing.
- A pixel centre hits a face whose chord c on the line is shorter than a pixel with probability c only, so the crossing
  has the weight 1 / c. If the surface continues, the next faces stand in for a missed one. If the previous pixel shows
  another surface, behind the chord's end, its colour does; if in front, its outline does, and the weight is 1.
- Where two surfaces meet at an edge, as at a T-junction, each edge has half of the gain.
- Seams, where two faces of a surface meet in different colours, take both colours from pixels that show them.
- Values that faces interpolate from their corners, such as depth, are known at each edge and on the surface behind it.
  Pixels show only whether the edge is visible.

The formulas are in `raster/kernels/edge.h`, on `crossings.h`; those of known values in `corner_values.h`.

Where two faces intersect, the visible boundary is the line of equal depth; see `intersections`.

Layers. A picture of K transparent layers has a visible boundary in each. Layer k shows the k-th nearest face of each
pixel. Let S be the composite of layer k and all behind it, and T the transmittance of the layers in front. Where a face
of layer k ends, the next face behind it becomes layer k of the next pixel, so the picture jumps by the jump of T S, as
at an opaque face. The gradient of each layer follows from T S and its faces. Nothing counts twice:

- The faces behind move one layer up where a face ends, but none of them has an edge there.
- Where two faces intersect, they swap layers. `intersections` requires that each face lies in front at its own pixel,
  which is so in the layer of the nearer face only.
- At the outline of a closed surface, its front and its back end at the same edge. The jump of the front's layer has
  both; the back's edge, which lies behind a fold, is left out.
- But where edges of two layers lie between the same two pixel centres, the jump of T counts at both.

An estimate is the derivative of pixels averaged over shifts along the motion. Its mean over shifts averages again, so
the weights dL/dI count as if interpolated linearly along the motion. No estimate from one image avoids it: a mean is
continuous in the place of the boundary, but the weight of the pixel that contains the boundary jumps.

Pitfalls. Otherwise the mean is exact, with these exceptions: sampled colours that curve within a pixel; gaps narrower
than a pixel between two boundaries; boundaries along the border of the image, closer than a pixel; intersections where
the visible parts of both faces are narrow; chords shorter than `LEAST_CHORD`, whose colour has a part of its gradient
only; edges with an end behind the camera, which get no gradient. Seams of sampled colours between triangles of half a
pixel to two pixels are exact to 3 %, but noisy; one is lost if no pixel near the centroid of one of its faces shows
that face.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
from collections.abc import Sequence
from typing import Any, NamedTuple, Optional

import torch
from torch import Tensor

from ..colors.downsample import averaged, change_averaged, changes_averaged, like_averaged, spread, whole
from ..colors.texture_cubes import lit_cubes
from ..ops.half_edges import HalfEdges, count_boundary
from ..ops.neighbors import Neighbors, half_edges_of, neighbors
from ..ops.visible_faces import scene_of, visible_faces
from ..warp import registration
from ..warp.launch import launch
from ..warp.layout import concurrent, cpu_bands, empty_queue, face_tasks, in_any_order, line_threads, queue_of
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from .intersections import add_intersections, intersections_forward, pictures_of

_KERNELS, _FORWARD = Kernels(__name__, "edge.h"), Kernels(__name__ + ".forward", "edge.h")
_EdgeHashes, _Edges = _KERNELS.struct("EdgeHashes"), _KERNELS.struct("Edges")
_EdgeBackward, _EdgeForward = _KERNELS.struct("EdgeBackward"), _KERNELS.struct("EdgeForward")
_count_steps = _KERNELS.kernel("count_steps", _Edges)
_edge_backward = _KERNELS.kernel("edge_backward", _EdgeBackward, launch_bounds=(256, 2))
_queue_moving_face = _KERNELS.kernel("queue_moving_face", _Edges, only_cuda=True)
_find_moving_edges = _FORWARD.kernel("find_moving_edges", _EdgeForward)
_edge_forward = _FORWARD.kernel("edge_forward", _EdgeForward, launch_bounds=(256, 2))


class EdgeOptions(NamedTuple):
    """Options of `edge_gradient`, as integers, which torch's dispatcher can pass."""

    two_sided: int  # as in `coverage`, like ``perspective``, ``below`` and ``above``
    perspective: int
    seams: int  # whether colours may jump between adjacent faces of a surface, as with texture cubes and flat shading
    halved: int = 0  # whether blocks of 2 x 2 pixels are averaged (anti-aliasing), which saves a copy of the image
    boundary: int = -1  # as of `HalfEdges`
    below: int = 0
    above: int = 0


class EdgeInputs(NamedTuple):
    """The inputs of `edge_gradient`, which its derivatives take, too."""

    image: Tensor | None
    faces: Tensor
    face_index: Tensor
    options: EdgeOptions
    edge_hashes: Tensor | None
    siblings: Tensor | None
    textures: Tensor | None
    light: Tensor | None
    firsts: Tensor | None
    pictures: Tensor | None
    corner_values: Tensor | None

    @staticmethod
    def of(inputs: Sequence[Any]) -> "EdgeInputs":
        """Name the inputs, and make them contiguous where kernels need it."""
        image, faces, face_index, options, *others = inputs
        image = None if image is None else whole(image)
        return EdgeInputs(image, faces.contiguous(), face_index.contiguous(), EdgeOptions(*options), *others)

    @property
    def layers(self) -> list[tuple[Tensor | None, Tensor]]:
        """The image and the visible faces of each layer."""
        if self.pictures is None:
            return [(self.image, self.face_index)]
        return list(zip(self.pictures.contiguous(), self.face_index, strict=True))


@registration.operator
def edge_gradient(
    image: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    faces: Tensor,
    face_index: Tensor,
    options: Sequence[int],
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045
    siblings: Optional[Tensor] = None,  # noqa: UP045
    textures: Optional[Tensor] = None,  # noqa: UP045
    light: Optional[Tensor] = None,  # noqa: UP045
    firsts: Optional[Tensor] = None,  # noqa: UP045
    pictures: Optional[Tensor] = None,  # noqa: UP045
    corner_values: Optional[Tensor] = None,  # noqa: UP045
) -> Tensor:
    """Return the image, and in backward send a gradient through visibility to the faces.

    Args:
        image: Any number of channels with their background, before anti-aliasing, [B, C, H, W] float32. None stands for
            the silhouette, of one channel.
        faces: As in `coverage`, which finds the ``face_index``.
        face_index: [B, H, W] int32, or [K, B, H, W] with ``pictures``, as from `peel`.
        options: `EdgeOptions`. Without ``seams``, edges between adjacent faces have no gradient, which is right, and
            less noisy, for interpolated colours.
        edge_hashes: [1 or B, F, 3, 2] int64 from `texture_edge_hashes` or `image_edge_hashes`. An edge whose hashes
            match is not a seam. None: every edge may be a seam, unless ``textures`` are given.
        siblings: Those of `HalfEdges` for the vertex indices of the faces, which replace the search for adjacent faces.
        textures, light, firsts: The colours that `texture_edge_hashes` would hash, instead of hashes; not on CUDA.
        pictures: T S of each of K layers (see above), [K, B, C, H, W] float32; without a gradient. ``image`` is then
            the picture of all layers.
        corner_values: [1 or B, F, 3, K] float32, what faces interpolate in the last K channels of the image. Then the
            values at edges are known, also where faces are smaller than a pixel; without a gradient. If K is less than
            C, they continue over seams.

    Returns:
        A copy of the image, [B, C, H, W] float32, or [B, C, H / 2, W / 2] if ``halved``. Backward sends its gradient to
        the image, and gradients to x and y of faces; where faces intersect, also to z. There is no second derivative
        (RuntimeError).
    """
    return averaged(None if image is None else whole(image), face_index, bool(options[_HALVED]))


_HALVED, _PICTURES = EdgeOptions._fields.index("halved"), EdgeInputs._fields.index("pictures")


@registration.fake(edge_gradient)
def _(image: Tensor | None, face_index: Tensor, options: Sequence[int], pictures: Tensor | None) -> Tensor:
    return like_averaged(image, face_index if pictures is None else face_index[0], bool(options[_HALVED]))


@registration.gradient_of(edge_gradient, "faces", once=True)
def edge_gradient_backward(grad: Tensor, *inputs: Any) -> Tensor:
    """Compute the gradient [B, F, 3, 3] float32 that `edge_gradient` sends to its faces.

    ``grad`` is the gradient to the image, or to the means of its blocks of 2 x 2 pixels, [B, C, H / 2, W / 2].
    """
    given = EdgeInputs.of(inputs)
    result = zeros(given.faces.shape, given.faces.device)
    if result.numel() == 0 or grad.numel() == 0:
        return result
    adjacent = _adjacent(given)
    for k, (image, face_index) in enumerate(given.layers):
        to_faces = result if k == 0 else zeros(result.shape, result.device)
        Edges(given, adjacent, image, face_index, grad).add_gradient(to_faces)
        if k > 0:
            result += to_faces
    return result


@registration.forward_operator(2, edge_gradient)
def edge_gradient_forward(
    to_image: Optional[Tensor],  # noqa: UP045
    motion: Tensor,
    *inputs: Any,
) -> Tensor:
    """Compute the tangent of `edge_gradient` in T directions, [T, B, C, H, W] or halved; the transpose of its backward.

    ``to_image`` is the tangent of the image, [T, B, C, H, W] float32, or None for 0. ``motion`` is that of the faces,
    [T, B, F, 3, 3] float32.
    """
    given, motion = EdgeInputs.of(inputs), motion.contiguous()
    shown = given.layers[0][1]
    result = changes_averaged(to_image, len(motion), given.image, shown, bool(given.options.halved))
    if motion.numel() == 0 or result.numel() == 0:
        return result
    adjacent = _adjacent(given)
    for image, face_index in given.layers:
        Edges(given, adjacent, image, face_index, result[0]).add_change(result, motion)
    return result


class _Adjacent(NamedTuple):
    """The neighbours of faces, each [B, F, 3] int32."""

    faces: Tensor  # across each edge, as from `neighbors`
    folds: Tensor | None = None  # that the surface folds back to; only the front one gets the gradient there
    search: HalfEdges | None = None  # on CUDA, half-edges of a closed mesh; kernels find `faces` with them


def _adjacent(given: EdgeInputs) -> _Adjacent:
    """Find the adjacent faces, and for hidden layers those at folds; on CUDA the kernels may search instead."""
    faces, options = given.faces, given.options
    known = None if given.siblings is None else HalfEdges(given.siblings, options.boundary)
    search = (faces, bool(options.two_sided), bool(options.perspective), known)
    if given.pictures is not None:
        return _Adjacent(neighbors(*search), neighbors(*search, folds=True))
    if known and in_any_order(faces.device) and count_boundary(known) == 0:
        return _Adjacent(empty((*faces.shape[:2], 3), faces.device, torch.int32), None, known)
    return _Adjacent(neighbors(*search))


class Edges:
    """The outlines and seams of one layer of images, for both modes of differentiation.

    Args:
        given: Inputs of `edge_gradient`.
        adjacent: Neighbours of the faces.
        image: Image of the layer, [B, C, H, W] float32; None for the silhouette.
        face_index: Visible faces of the layer, [B, H, W] int32.
        grad: Gradient as in `edge_gradient_backward`; in forward mode any map of its shape.
    """

    def __init__(
        self, given: EdgeInputs, adjacent: _Adjacent, image: Tensor | None, face_index: Tensor, grad: Tensor
    ) -> None:
        faces, options, edge_hashes = given.faces, given.options, given.edge_hashes
        batch, height, width = face_index.shape
        count, device = faces.shape[1], faces.device
        self._faces, self._lines, self._adjacent = faces, (height, width), adjacent.faces
        self._shows_intersections = image is not None  # where two faces of a silhouette meet, both are 1
        cubes = None
        if given.textures is not None and given.light is not None:
            cubes = lit_cubes(given.textures, given.light, firsts=given.firsts)
        if edge_hashes is None and cubes is None and options.seams:
            edge_hashes = torch.zeros((1, 1, 3, 2), dtype=torch.int64, device=device)  # 0 matches nothing
        self._scene = scene_of(faces, face_index, bool(options.perspective), options.below, options.above)
        self._pictures = pictures_of(image, grad, width, given.corner_values)
        fields: dict[str, Any] = {
            "scene": self._scene,
            "pictures": self._pictures,
            "neighbors": Neighbors(
                scene=self._scene,
                two_sided=int(adjacent.search is not None and options.two_sided),
                side=-1,
                half_edges=half_edges_of(adjacent.search),
                adjacent=adjacent.faces,
            ),
            "folds": adjacent.folds,
            "visible": visible_faces(face_index, count),
            "seams": options.seams,
            "textures": cubes,
        }
        if edge_hashes is not None:
            images, hashed = edge_hashes.shape[:2]
            fields["edge_hashes"] = _EdgeHashes(values=edge_hashes.contiguous(), images=images, count=hashed)
        queue = empty_queue(batch * count, device) if in_any_order(device) else None
        if not concurrent(device):
            fields["steps"] = torch.empty((batch, count + 1), dtype=torch.uint8, device=device)
        if queue is not None:
            launch(_queue_moving_face, batch * count, [_Edges(queue=queue_of(queue), **fields)], device)
        self._threads = line_threads(batch * count, queue, 1)
        self._call = _Edges(queue=queue_of(queue, self._threads), **fields)
        if not concurrent(device):
            launch(_count_steps, batch, [self._call], device)

    def add_gradient(self, to_faces: Tensor) -> None:
        """Add the gradient of the corners to ``to_faces``, [B, F, 3, 3] float32."""
        call = _EdgeBackward(edges=self._call, to_faces=to_faces)
        height, width = self._lines
        launch(_edge_backward, self._threads, [call], to_faces.device, face_tasks(to_faces, height * width))
        if self._shows_intersections:
            add_intersections(to_faces, self._scene, self._pictures, self._adjacent)

    def add_change(self, images: Tensor, motion: Tensor) -> None:
        """Add the change to images [T, B, C, H, W] float32, or halved ones, for motions [T, B, F, 3, 3] of corners."""
        device, (batch, count) = images.device, self._faces.shape[:2]
        fields = {"edges": self._call, "motion": motion, "directions": len(motion), "images": images}
        if in_any_order(device):
            launch(_edge_forward, self._threads, [_EdgeForward(**fields)], device)
        else:
            self._add_change_by_bands(fields, batch, count, device)
        if self._shows_intersections:
            intersections_forward(images, motion, self._scene, self._pictures, self._adjacent)

    def _add_change_by_bands(self, fields: dict[str, Any], batch: int, count: int, device: torch.device) -> None:
        fields["moving"] = torch.empty((batch, count), dtype=torch.uint8, device=device)
        least = face_tasks(self._faces, self._lines[0] * self._lines[1])
        launch(_find_moving_edges, batch * count, [_EdgeForward(**fields)], device, least)
        for axis, lines in enumerate(self._lines):  # one after the other, because their lines cross
            band = 2 * -(-lines // (2 * cpu_bands(batch, lines * self._lines[1 - axis] + 32 * count)))  # whole blocks
            call = _EdgeForward(axis=axis, band=band, **fields)
            launch(_edge_forward, batch * -(-lines // band), [call], device)


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    image, *others = inputs
    ctx.in_blocks = image is not None and image.dim() == 6
    keep_image = image if inputs[_PICTURES] is None else None  # the pictures of layers replace it
    registration.save_inputs(ctx, (keep_image, *others), output)  # not the output, which callers may change


def _backward(ctx: Any, grad: Tensor) -> Any:
    inputs = registration.saved_inputs(ctx)
    found = {}
    if ctx.needs_input_grad[0]:
        found["image"] = spread(grad, ctx.in_blocks) if inputs[3][_HALVED] else grad
    if ctx.needs_input_grad[1]:
        found["faces"] = edge_gradient_backward(grad, *inputs)
    return found


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    to_image, motion = tangents[:2]
    if motion is None:
        return change_averaged(to_image, bool(inputs[3][_HALVED]))
    return registration.in_direction(edge_gradient_forward, (to_image, motion), *inputs)


registration.differentiable(edge_gradient, _backward, _save, _forward)
