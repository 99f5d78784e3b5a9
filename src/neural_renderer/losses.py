"""Losses on images and on meshes; each returns one number and is differentiable in its floating arguments.

They compute in float32 what is given in half precision, whose numbers end at 65504: a sum over a picture is soon more.
An empty batch costs 0, with a gradient (of no elements). A NaN in an image makes the loss NaN; one in vertices is a
ValueError if values are checked.
"""

from __future__ import annotations

import torch
from torch import Tensor

from . import validate
from .meshes.normals import face_normals
from .meshes.topology import Topology


def silhouette_iou(predicted: Tensor, target: Tensor, eps: float = 1e-6) -> Tensor:
    """1 − intersection over union of silhouettes, averaged over the batch: 0 where they agree, 1 where they do not.

    Per image 1 − Σ(s·ŝ) / Σ(s + ŝ − s·ŝ): the silhouette loss of section 4.1 of the paper, plus 1.

    Args:
        predicted: [B, H, W] floating, in [0, 1].
        target: [B, H, W], in [0, 1], of any dtype.
        eps: the least union, in pixels; two silhouettes that are both empty agree (0, without a gradient).

    Raises:
        TypeError, ValueError: wrong types, shapes or devices.
    """
    predicted = _wide(validate.floating("predicted", predicted, ("B", "H", "W")))
    target = _like("target", target, predicted)
    intersection = (predicted * target).sum((1, 2))
    union = (predicted + target - predicted * target).sum((1, 2))
    iou = intersection / union.clamp(min=eps)
    return _mean(1 - torch.where(union <= eps, torch.ones_like(iou), iou))  # this way round NaN stays NaN


def photometric(image: Tensor, target: Tensor, mask: Tensor | None = None) -> Tensor:
    """The mean squared difference of images [B, C, H, W] over all pixels and channels.

    Args:
        image: [B, C, H, W] floating.
        target: like ``image``.
        mask: [B, H, W] or None: the weight of each pixel; the mean is weighted by it (0 if all weights are 0).

    Raises:
        TypeError, ValueError: wrong types, shapes or devices.
    """
    image = _wide(validate.floating("image", image, ("B", "C", "H", "W")))
    squared = (image - _like("target", target, image)).square()
    if mask is None:
        return _mean(squared)
    weight = _like("mask", mask, image[:, 0])
    return (squared.mean(1) * weight).sum() / weight.sum().clamp(min=1e-6)


def total_variation(images: Tensor, mask: Tensor | None = None) -> Tensor:
    """The sum of squared differences of each pixel to its right and its lower neighbour.

    Args:
        images: [B, C, H, W] floating.
        mask: [B, H, W] or None: the weight of the differences that start at each pixel.

    Returns:
        The sum over pixels, channels and images, as the published style transfer has it: not a mean.

    Raises:
        TypeError, ValueError: wrong types, shapes or devices.
    """
    images = _wide(validate.floating("images", images, ("B", "C", "H", "W")))
    right = (images[..., :, 1:] - images[..., :, :-1]).square()
    down = (images[..., 1:, :] - images[..., :-1, :]).square()
    if mask is not None:
        weight = _like("mask", mask, images[:, 0])[:, None]
        right, down = right * weight[..., :, :-1], down * weight[..., :-1, :]
    return right.sum() + down.sum()


def laplacian(vertices: Tensor, faces: Tensor | Topology) -> Tensor:
    """The mean over vertices of the squared distance to the mean of their neighbours (uniform weights).

    Args:
        vertices: [V, 3] or [B, V, 3] floating.
        faces: [F, 3], whole numbers of any real dtype, or a `Topology` made of them once; the latter only under
            torch.compile.

    Returns:
        The mean over the batch; a vertex without edges counts as 0. O(E).

    Raises:
        TypeError, ValueError: wrong types, shapes or devices; face indices out of range and vertices that are not
            finite if values are checked.
    """
    vertices, topology = _prepared(vertices, faces)
    start, end = torch.cat((topology.edges, topology.edges.flip(1))).unbind(1)
    total = torch.zeros_like(vertices).index_add(-2, start, vertices.index_select(-2, end))
    ones = torch.ones_like(start, dtype=vertices.dtype)
    degree = ones.new_zeros(vertices.shape[-2]).index_add(0, start, ones)[:, None]
    offset = (total / degree.clamp(min=1) - vertices) * (degree > 0)
    return offset.square().sum() / max(offset.numel() // 3, 1)


def edge_length(vertices: Tensor, faces: Tensor | Topology) -> Tensor:
    """The mean squared length of the edges, over edges and batch; arguments and errors as `laplacian`."""
    vertices, topology = _prepared(vertices, faces)
    start, end = topology.edges.unbind(1)
    edge = vertices.index_select(-2, end) - vertices.index_select(-2, start)
    return edge.square().sum() / max(edge.numel() // 3, 1)


def normal_consistency(vertices: Tensor, faces: Tensor | Topology) -> Tensor:
    """The mean of 1 − cos of the angle between the normals of faces that share an edge: 0 where all is flat.

    The faces' winding does not matter. Arguments and errors as `laplacian`; the mean is over edges and batch.
    """
    bend = _bend(vertices, faces)
    return bend.sum() / max(bend.numel(), 1)


def smoothness(vertices: Tensor, faces: Tensor | Topology) -> Tensor:
    """Σ (cos θ + 1)² over the edges, averaged over the batch: the smoothness loss of section 4.1 of the paper.

    θ is the angle between the two faces at an edge: 180° where they are flat. Arguments and errors as `laplacian`.
    """
    bend = _bend(vertices, faces)
    return bend.square().sum() / max(bend.shape[0] if bend.ndim == 2 else 1, 1)


def _bend(vertices: Tensor, faces: Tensor | Topology) -> Tensor:
    """1 + cos θ = 1 − n·n' for each pair of faces at an edge, [I] or [B, I]."""
    vertices, topology = _prepared(vertices, faces)
    v0, v1, v2, v3 = (vertices.index_select(-2, i) for i in topology.hinges.unbind(1))
    normal = face_normals(torch.stack((v0, v1, v2), dim=-2))
    neighbour = face_normals(torch.stack((v1, v0, v3), dim=-2))
    return 1 - (normal * neighbour).sum(-1)


def _prepared(vertices: Tensor, faces: Tensor | Topology) -> tuple[Tensor, Topology]:
    validate.vertices(vertices)
    topology = faces if isinstance(faces, Topology) else Topology.of(faces)
    validate.same_device(vertices=vertices, faces=topology.edges)
    if topology.vertices > vertices.shape[-2]:
        raise ValueError(f"faces: expected indices in [0, {vertices.shape[-2]}), got {topology.vertices - 1}")
    return _wide(vertices), topology


def _wide(value: Tensor) -> Tensor:
    return value.to(torch.promote_types(value.dtype, torch.float32))


def _mean(value: Tensor) -> Tensor:
    return value.mean() if value.numel() else value.sum()


def _like(name: str, value: Tensor, other: Tensor) -> Tensor:
    """``value`` in the dtype of ``other``, whose shape and device it must have."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch tensor, got {type(value).__name__}")
    validate.dense(name, value)
    if value.shape != other.shape:
        raise ValueError(f"{name}: expected shape {list(other.shape)}, got {validate.shape_of(value)}")
    validate.same_device(**{"the other image": other, name: value})
    return value.to(other.dtype)
