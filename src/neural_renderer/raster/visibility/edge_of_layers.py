"""The derivative of a picture of several layers through the visibility of each: `edge_gradient` for transparency.

Maths. Layer k shows the k-th nearest face of each pixel. Let S be the composite of layer k and all behind it, and T the
transmittance of the layers in front. Where a face of layer k ends, the next face behind it becomes layer k of the next
pixel, so the picture jumps by the jump of T S, as at an opaque face, and `edge` computes the gradient of each layer
from T S and its faces. Nothing counts twice:

- The faces behind move one layer up where a face ends, but none of them has an edge there.
- Where two faces intersect, they change places. `intersections` requires that each face lies in front at its own
  pixel, which is so in the layer of the nearer face only.
- At the outline of a closed surface, its front and its back end at the same edge. The jump of the front's layer has
  both; the back's edge, which is behind a fold, is left out.

Pitfalls. All of `edge` apply; its "gaps narrower than a pixel" include gaps between the edges of two layers. Faces
behind the last layer are ignored.
"""

# The types of operators are read at run time, so no `from __future__ import annotations` here.
from collections.abc import Sequence
from typing import Any, Optional

import torch
from torch import Tensor

from ..colors.downsample import averaged, change_averaged, changes_averaged, halve_backward, like_averaged
from ..ops.neighbors import neighbors
from ..ops.rings import Rings
from ..warp.memory import zeros
from ..warp.registration import differentiable, differentiable_once, fake, forward_operator, in_direction, operator
from .edge import Edges
from .intersections import add_intersections, push_intersections


@operator
def layers_gradient(
    image: Tensor,
    pictures: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045 (schemas are inferred from it)
    rings: Optional[Tensor] = None,  # noqa: UP045
    halved: bool = False,
    alone: int = -1,
) -> Tensor:
    """Return the picture, and in backward send a gradient through the visibility of each layer to the faces.

    ``pictures`` are T S of each layer, [K, B, C, H, W] float32, and get no gradient. ``face_index`` is as from `peel`,
    [K, B, H, W] int32. Other arguments, and the result, are as in `edge_gradient`.
    """
    return averaged(image, face_index, halved)


@fake(layers_gradient)
def _(image: Tensor, face_index: Tensor, halved: bool) -> Tensor:
    return like_averaged(image, face_index[0], halved)


@differentiable_once
def layers_gradient_backward(
    grad: Tensor,
    pictures: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045
    rings: Optional[Tensor] = None,  # noqa: UP045
    alone: int = -1,
) -> Tensor:
    """Compute the gradient [B, F, 3, 3] float32 that `layers_gradient` sends to its faces; arguments as there."""
    grad, faces = grad.contiguous(), faces.contiguous()
    result = zeros(faces.shape, faces.device)
    if result.numel() == 0 or pictures.numel() == 0:
        return result
    adjacent, folds = _adjacent_and_folds(faces, two_sided, perspective, rings, alone)
    for image, index in zip(pictures.contiguous(), face_index.contiguous(), strict=True):
        own = zeros(faces.shape, faces.device)
        Edges(image, grad, faces, index, adjacent, perspective, seams, edge_hashes, folds).add_gradient(own)
        add_intersections(own, grad, image, faces, index, adjacent, perspective)
        result += own
    return result


@fake(layers_gradient_backward)
def _(faces: Tensor) -> Tensor:
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


@forward_operator(2)
def layers_gradient_forward(
    to_image: Optional[Tensor],  # noqa: UP045
    motion: Tensor,
    pictures: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Optional[Tensor] = None,  # noqa: UP045
    rings: Optional[Tensor] = None,  # noqa: UP045
    halved: bool = False,
    alone: int = -1,
) -> Tensor:
    """Compute the change of `layers_gradient` in T directions; arguments as there and in `edge_gradient_forward`."""
    faces, motion = faces.contiguous(), motion.contiguous()
    result = changes_averaged(to_image, len(motion), pictures[0], face_index[0], halved)
    if motion.numel() == 0 or result.numel() == 0:
        return result
    adjacent, folds = _adjacent_and_folds(faces, two_sided, perspective, rings, alone)
    for image, index in zip(pictures.contiguous(), face_index.contiguous(), strict=True):
        edges = Edges(image, result[0], faces, index, adjacent, perspective, seams, edge_hashes, folds)
        edges.push(result, motion)
        push_intersections(result, motion, image, faces, index, adjacent, perspective)
    return result


@fake(layers_gradient_forward)
def _(motion: Tensor, pictures: Tensor, face_index: Tensor, halved: bool) -> Tensor:
    one = like_averaged(pictures[0], face_index[0], halved)
    return one.new_empty((len(motion), *one.shape))


def _adjacent_and_folds(
    faces: Tensor, two_sided: bool, perspective: bool, rings: Tensor | None, alone: int
) -> tuple[Tensor, Tensor]:
    known = None if rings is None else Rings(rings, alone)
    adjacent, folds = (neighbors(faces, two_sided, perspective, known, fold) for fold in (False, True))
    return adjacent, folds


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    _, pictures, faces, face_index, ctx.two_sided, ctx.perspective, ctx.seams, hashes, rings, ctx.halved, ctx.alone = (
        inputs
    )
    ctx.save_for_backward(pictures, faces, face_index, hashes, rings)


def _backward(ctx: Any, grad: Tensor) -> Any:
    pictures, faces, face_index, *rest = ctx.saved_tensors
    grad = halve_backward(grad) if ctx.halved else grad
    to_faces = None
    if ctx.needs_input_grad[2]:
        options = (ctx.two_sided, ctx.perspective, ctx.seams, *rest, ctx.alone)
        to_faces = layers_gradient_backward(grad, pictures, faces, face_index, *options)
    return grad, None, to_faces, *[None] * 8


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    _, pictures, faces, face_index, two_sided, perspective, seams, edge_hashes, rings, halved, alone = inputs
    to_image, _, motion = tangents[:3]
    if motion is None:
        return change_averaged(to_image, halved)
    options = (two_sided, perspective, seams, edge_hashes, rings, halved, alone)
    return in_direction(layers_gradient_forward, (to_image, motion), pictures, faces, face_index, *options)


differentiable(layers_gradient, _backward, _save, _forward)
