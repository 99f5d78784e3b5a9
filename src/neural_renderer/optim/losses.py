"""Losses on images and on meshes.

Each loss returns a scalar tensor, or with ``reduction="none"`` one number for each image or mesh of the batch. It is
differentiable in its floating arguments. Half-precision input is summed in float32, because a sum over an image
overflows float16. The loss of an empty batch is 0. NaN in an image gives a NaN loss; NaN in vertices raises ValueError
while values are checked (`check_values`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import torch
from torch import Tensor

from ..base import private, validate
from ..meshes.normals import hinge_normals
from ..meshes.topology import Topology
from ..raster.warp.registration import is_eager

_Loss = TypeVar("_Loss", bound=Callable[..., Tensor])


def silhouette_iou_loss(predicted: Tensor, target: Tensor, eps: float = 1e-6, *, reduction: str = "mean") -> Tensor:
    """Compute 1 − IoU of anti-aliased silhouettes, averaged over the batch.

    The loss of one image is 1 − Σ min(s, ŝ) / Σ max(s, ŝ) over its pixels: 0 for equal silhouettes, also where their
    borders cover pixels in part, and 1 for disjoint ones. It is D / U with D = Σ d, U = Σ(s + ŝ + d) / 2 and the
    distance d of s and ŝ. Where both lie within (0, 1), the smooth d = (s − ŝ)² / (s + ŝ − 2sŝ) replaces the
    distance, so that descent comes to rest. For a binary target the loss equals `soft_iou_loss`.

    Args:
        predicted: [B, H, W] floating, in [0, 1].
        target: [B, H, W] of any dtype, in [0, 1].
        eps: Least union, in pixels. Two empty silhouettes have loss 0 and no gradient.
        reduction: "mean" or "sum" over the batch, or "none" for a loss [B] of each image.

    Returns:
        Scalar tensor in [0, 1]; [B] for "none".

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or the reduction is unknown.

    Example:
        >>> square = torch.zeros(1, 8, 8)
        >>> square[:, 2:6, 2:6] = 1
        >>> silhouette_iou_loss(square, square.roll(1, 2))  # 12 pixels of 20 are shared
        tensor(0.4000)
    """
    return _iou_loss(_smooth_difference, predicted, target, eps, reduction)


def soft_iou_loss(predicted: Tensor, target: Tensor, eps: float = 1e-6, *, reduction: str = "mean") -> Tensor:
    """Compute 1 − Σ(s·ŝ) / Σ(s + ŝ − s·ŝ): the paper's silhouette loss (section 4.1) plus 1.

    A pixel that both silhouettes cover by half contributes a quarter to the intersection. So equal anti-aliased
    silhouettes have a loss above 0, unlike with `silhouette_iou_loss`.

    Args:
        predicted, target, eps, reduction: As in `silhouette_iou_loss`.

    Returns:
        Scalar tensor in [0, 1]; [B] for "none".

    Raises:
        TypeError, ValueError: As `silhouette_iou_loss`.

    Example:
        >>> half = torch.full((1, 8, 8), 0.5)
        >>> soft_iou_loss(half, half)  # 1 − 0.25 / 0.75
        tensor(0.6667)
    """
    return _iou_loss(_difference, predicted, target, eps, reduction)


def _iou_loss(
    difference: Callable[[Tensor, Tensor], Tensor], predicted: Any, target: Any, eps: float, reduction: str
) -> Tensor:
    """Compute 1 − IoU from each pixel's symmetric difference."""
    predicted = _wide(validate.floating("predicted", predicted, ("B", "H", "W")))
    target = _like("target", target, predicted)
    disjoint = difference(predicted, target)
    union = (predicted + target + disjoint).sum((1, 2)) / 2
    each = torch.where(union <= eps, 0.0, disjoint.sum((1, 2)) / union.clamp(min=eps))  # in this order NaN stays NaN
    return _reduced(each, reduction)


def _difference(a: Tensor, b: Tensor) -> Tensor:
    """Compute a + b − 2ab, the expected symmetric difference if both cover independent parts of a pixel."""
    return a + b - 2 * a * b


def _smooth_difference(a: Tensor, b: Tensor) -> Tensor:
    """Compute (a − b)² / (a + b − 2ab): |a − b| if one is 0 or 1, otherwise less, and smooth."""
    if not is_eager((a, b)) or private.transforms_active():
        separate = _difference(a, b)
        return torch.where(_is_whole(a) & _is_whole(b), separate, _smooth_quotient(a, b))
    # Few pixels are partly covered, and only those need more than one product.
    separate = a * (1 - 2 * b) + b
    rows = torch.nonzero(~(_is_whole(a) & _is_whole(b)).flatten()).flatten()
    inside = _smooth_quotient(a.flatten()[rows], b.flatten()[rows])
    return separate.flatten().index_put((rows,), inside).view(a.shape)


def _is_whole(a: Tensor) -> Tensor:
    return a * a == a


def _smooth_quotient(a: Tensor, b: Tensor) -> Tensor:
    separate = _difference(a, b)
    return (a - b) * ((a - b) / torch.where(separate == 0, 1.0, separate))


def photometric(image: Tensor, target: Tensor, mask: Tensor | None = None, *, reduction: str = "mean") -> Tensor:
    """Compute the mean squared difference of images over pixels and channels.

    Args:
        image: [B, C, H, W] floating.
        target: [B, C, H, W].
        mask: [B, H, W] pixel weights of a weighted mean, or None for equal weights. The loss is 0 if all weights are 0.
        reduction: "none" for a loss [B] of each image, "sum" for their sum, or "mean" over all pixels of the batch,
            weighted by the images' total weights.

    Returns:
        Scalar tensor, ≥ 0; [B] for "none".

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or the reduction is unknown.

    Example:
        >>> photometric(torch.ones(1, 3, 8, 8), torch.zeros(1, 3, 8, 8))
        tensor(1.)
    """
    image = _wide(validate.floating("image", image, ("B", "C", "H", "W")))
    squared = (image - _like("target", target, image)).square()
    if mask is None:
        # The mean over no pixels is 0.
        return _reduced(squared.sum((1, 2, 3)) / max(squared[0].numel() if len(squared) else 1, 1), reduction)
    weight = _like("mask", mask, image[:, 0])
    total, area = (squared.mean(1) * weight).sum((1, 2)), weight.sum((1, 2))
    if reduction == "mean":
        return total.sum() / area.sum().clamp(min=1e-6)
    return _reduced(total / area.clamp(min=1e-6), reduction)


def total_variation(images: Tensor, mask: Tensor | None = None, *, reduction: str = "sum") -> Tensor:
    """Sum the squared differences between each pixel and its right and lower neighbours.

    Args:
        images: [B, C, H, W] floating.
        mask: [B, H, W] pixel weights, or None for equal ones. A difference gets that of its left or upper pixel.
        reduction: "mean" or "sum" over the batch, or "none" for a loss [B] of each image.

    Returns:
        Scalar tensor; [B] for "none". By default a sum over everything, as in the published style transfer.

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or the reduction is unknown.

    Example:
        >>> image = torch.zeros(1, 1, 4, 4)
        >>> image[0, 0, 1, 1] = 1  # one pixel differs from its four neighbours
        >>> total_variation(image)
        tensor(4.)
    """
    images = _wide(validate.floating("images", images, ("B", "C", "H", "W")))
    right = (images[..., :, 1:] - images[..., :, :-1]).square()
    down = (images[..., 1:, :] - images[..., :-1, :]).square()
    if mask is not None:
        weight = _like("mask", mask, images[:, 0])[:, None]
        right, down = right * weight[..., :, :-1], down * weight[..., :-1, :]
    return _reduced(right.sum((1, 2, 3)) + down.sum((1, 2, 3)), reduction)


def _of_each_mesh(loss: _Loss) -> _Loss:
    """Extend a loss of vertices and faces to faces [B, F, 3], as `batch` makes them: one loss per mesh."""

    @functools.wraps(loss)
    def of_each(vertices: Tensor, faces: Any, *, reduction: str = "mean", **options: Any) -> Tensor:
        if getattr(faces, "ndim", 2) != 3:
            return loss(vertices, faces, reduction=reduction, **options)
        validate.floating("vertices", vertices, ("B", "V", 3))
        validate.indices("faces", faces, (len(vertices), "F", 3))
        if not faces.stride(0):  # one mesh, expanded
            return loss(vertices, faces[0], reduction=reduction, **options)
        losses = []
        for points, rows in zip(vertices, faces, strict=True):
            topology = Topology.of(rows[(rows != -1).any(1)])
            # Vertices beyond the last that a face uses are padding.
            if topology.vertices > len(points):
                raise ValueError(f"faces: expected indices in [0, {len(points)}), got {topology.vertices - 1}")
            losses.append(loss(points[: topology.vertices], topology, reduction="sum", **options))
        return _reduced(torch.stack(losses) if losses else vertices.sum((1, 2)), reduction)

    return of_each  # type: ignore[return-value]


@_of_each_mesh
def laplacian(vertices: Tensor, faces: Tensor | Topology, *, squared: bool = True, reduction: str = "mean") -> Tensor:
    """Compute the uniform Laplacian loss: the mean squared distance of vertices to the centroid of their neighbours.

    PyTorch3D's ``mesh_laplacian_smoothing`` is the mean of the distances themselves: ``squared=False``. Its gradient
    has the same length at every vertex, so it needs other weights.

    Args:
        vertices: [V, 3] or [B, V, 3] floating.
        faces: [F, 3] whole numbers of any real dtype, or a `Topology` built from them once. torch.compile needs a
            `Topology`. Or [B, F, 3], as `batch` makes them; rows of −1, and vertices after the last used one, are
            padding.
        squared: Square the distances.
        reduction: "mean" or "sum" over the batch, or "none" for a loss [B] of each mesh.

    Returns:
        Scalar tensor; [B] for "none": the mean over vertices. A vertex without edges adds 0. Cost O(E).

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or the reduction is unknown; while values are
            checked, also a face index out of range or a vertex that is not finite.

    Example:
        >>> sphere = nr.Mesh.icosphere(2).trainable()
        >>> laplacian(sphere.vertices, sphere.faces).backward()
    """
    vertices, topology = _prepared(vertices, faces)
    start, end = torch.cat((topology.edges, topology.edges.flip(1))).unbind(1)
    total = torch.zeros_like(vertices).index_add(-2, start, vertices.index_select(-2, end))
    ones = torch.ones_like(start, dtype=vertices.dtype)
    degree = ones.new_zeros(vertices.shape[-2]).index_add(0, start, ones)[:, None]
    offset = (total / degree.clamp(min=1) - vertices) * (degree > 0)
    each = offset.square().sum(-1) if validate.flag("squared", squared) else torch.linalg.vector_norm(offset, dim=-1)
    return _reduced(each.sum(-1) / max(offset.shape[-2], 1), reduction)


@_of_each_mesh
def edge_length(vertices: Tensor, faces: Tensor | Topology, *, reduction: str = "mean") -> Tensor:
    """Compute the mean squared edge length.

    Args:
        vertices, faces, reduction: As in `laplacian`.

    Returns:
        Scalar tensor, ≥ 0; [B] for "none": the mean over edges.

    Raises:
        TypeError, ValueError: As `laplacian`.

    Example:
        >>> triangle = torch.tensor([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
        >>> edge_length(triangle, torch.tensor([[0, 1, 2]]))  # (9 + 16 + 25) / 3
        tensor(16.6667)
    """
    vertices, topology = _prepared(vertices, faces)
    start, end = topology.edges.unbind(1)
    edge = vertices.index_select(-2, end) - vertices.index_select(-2, start)
    return _reduced(edge.square().sum((-2, -1)) / max(edge.shape[-2], 1), reduction)


@_of_each_mesh
def normal_consistency(vertices: Tensor, faces: Tensor | Topology, *, reduction: str = "mean") -> Tensor:
    """Compute the mean of 1 − cos φ over edges; φ is the angle between the normals of the two adjacent faces.

    The loss of a flat surface is 0. The winding of faces does not matter.

    Args:
        vertices, faces, reduction: As in `laplacian`.

    Returns:
        Scalar tensor in [0, 2]; [B] for "none": the mean over edges.

    Raises:
        TypeError, ValueError: As `laplacian`.

    Example:
        >>> vertices, faces = nr.cube()
        >>> normal_consistency(vertices, faces)  # 12 of its 18 edges are at right angles, 6 are flat
        tensor(0.6667)
    """
    bend = _bend(vertices, faces)
    return _reduced(bend.sum(-1) / max(bend.shape[-1], 1), reduction)


@_of_each_mesh
def smoothness(vertices: Tensor, faces: Tensor | Topology, *, reduction: str = "mean") -> Tensor:
    """Sum (cos θ + 1)² over edges and average over the batch: the paper's smoothness loss (section 4.1).

    θ is the dihedral angle, 180° on a flat surface.

    Args:
        vertices, faces, reduction: As in `laplacian`.

    Returns:
        Scalar tensor, ≥ 0; [B] for "none": a sum over edges, by default a mean over the batch.

    Raises:
        TypeError, ValueError: As `laplacian`.

    Example:
        >>> vertices, faces = nr.cube()
        >>> smoothness(vertices, faces)  # 1 for each of the 12 edges at right angles
        tensor(12.)
    """
    bend = _bend(vertices, faces)
    return _reduced(bend.square().sum(-1), reduction)


def _bend(vertices: Tensor, faces: Tensor | Topology) -> Tensor:
    """Compute 1 + cos θ = 1 − n·n' for each pair of adjacent faces, [I] or [B, I]."""
    vertices, topology = _prepared(vertices, faces)
    corners = vertices.index_select(-2, topology.hinges.flatten()).unflatten(-2, topology.hinges.shape)
    normal, neighbour = hinge_normals(corners)
    return 1 - (normal * neighbour).sum(-1)


def _prepared(vertices: Tensor, faces: Tensor | Topology) -> tuple[Tensor, Topology]:
    """Check vertices and faces; return the vertices in at least float32, and the topology."""
    validate.vertices(vertices)
    topology = faces if isinstance(faces, Topology) else Topology.of(faces)
    validate.same_device(vertices=vertices, faces=topology.edges)
    if topology.vertices > vertices.shape[-2]:
        raise ValueError(f"faces: expected indices in [0, {vertices.shape[-2]}), got {topology.vertices - 1}")
    return _wide(vertices), topology


def _wide(value: Tensor) -> Tensor:
    return value.to(torch.promote_types(value.dtype, torch.float32))


def _reduced(each: Tensor, reduction: str) -> Tensor:
    """Reduce losses [B], or [] of a single mesh; an empty batch gives 0."""
    if reduction == "none":
        return each
    if reduction == "sum":
        return each.sum()
    if reduction == "mean":
        return each.mean() if each.numel() else each.sum()
    raise ValueError(f"reduction: expected 'none', 'mean' or 'sum', got {reduction!r}")


def _like(name: str, value: Tensor, other: Tensor) -> Tensor:
    """Return ``value`` in the dtype of ``other``; raise if shape or device differ."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch tensor, got {type(value).__name__}")
    validate.dense(name, value)
    if value.shape != other.shape:
        raise ValueError(f"{name}: expected shape {list(other.shape)}, got {validate.shape_of(value)}")
    validate.same_device(**{"the other image": other, name: value})
    return value.to(other.dtype)
