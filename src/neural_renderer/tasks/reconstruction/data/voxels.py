"""Meshes as voxels, in the frame and the axes of the published ground truth, and how well voxels agree."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .... import validate
from ....raster.ops.voxels import distances, fill, inside
from .framing import GRID

_SPACING = 0.25  # voxels, between points on a model's faces: what is thinner than a voxel is not lost


def voxelize(vertices: Tensor, faces: Tensor, size: int = GRID) -> Tensor:
    """Predicted meshes as the published evaluation voxelises them: surface and what it encloses.

    vertices: [B, V, 3] floating, in the frame of reconstruction (see `framing`), of which [−0.5, 0.5]³ is kept.
    faces: [F, 3], whole numbers of any real dtype.

    Returns [B, size, size, size] bool. The box is scaled by (size − 1)/size, so that voxel i along an axis has its
    centre at (i − (size − 1)/2)/(size − 1). The axes are (y, x, −z), as in the published `_voxels.npz`. For how voxels
    are marked and filled see `raster.voxels.fill`.

    Raises TypeError or ValueError for other types, shapes, devices, indices out of range, numbers that are not finite.
    """
    validate.floating("vertices", vertices, ["B", "V", 3])
    faces = validate.indices("faces", faces, ["F", 3])
    validate.same_device(vertices=vertices, faces=faces)
    validate.finite("vertices", vertices)
    validate.in_range("faces", faces, vertices.shape[1])
    size = validate.whole("size", size, 2)
    return _published_axes(fill(_grid(vertices.detach().float(), size), faces.int(), size))


def solid(vertices: Tensor, faces: Tensor, size: int = GRID) -> Tensor:
    """The ground truth [size, size, size] bool of a model: voxels that its surface passes through, and its inside.

    vertices: [V, 3] floating, faces: [F, 3], as `voxelize` takes them, of any quality. No part is lost for being
    thinner than a voxel, and a model with holes is not empty: inside is what the surface encloses, and where the
    generalised winding number is above a half. (Faces run clockwise seen from outside, since the frame of
    reconstruction mirrors; if they enclose a volume of the other sign they are taken the other way round.)
    """
    validate.floating("vertices", vertices, ["V", 3])
    faces = validate.indices("faces", faces, ["F", 3])
    validate.finite("vertices", vertices)
    validate.in_range("faces", faces, len(vertices))
    points = _grid(vertices.detach().cpu().float(), size)
    outward = faces.cpu().int().flip(1)
    filled = fill(points[None], outward, size, _SPACING)[0]
    corners = points[outward.long()] - size / 2
    if float(torch.linalg.det(corners.double()).sum()) < 0:
        outward = outward.flip(1)
    empty = (~filled).nonzero()
    wound = inside(points, outward, empty.float() + 0.5)
    filled[tuple(empty[wound].T)] = True
    return _published_axes(filled[None])[0]


def voxel_iou(predicted: Tensor, target: Tensor) -> Tensor:
    """Intersection over union [B] float32 of voxels [B, ...] bool; two empty ones agree (1).

    Raises TypeError or ValueError for other types or shapes that differ.
    """
    for name, value in (("predicted", predicted), ("target", target)):
        if not isinstance(value, Tensor) or value.dtype != torch.bool:
            got = validate.shape_of(value) if isinstance(value, Tensor) else type(value).__name__
            raise TypeError(f"{name}: expected a tensor of bool, got {got}")
    if predicted.shape != target.shape or predicted.ndim < 2:
        raise ValueError(
            f"predicted and target: expected the same shape [B, ...], got {list(predicted.shape)} and "
            f"{list(target.shape)}"
        )
    predicted, target = predicted.flatten(1), target.flatten(1)
    union = (predicted | target).sum(1)
    return torch.where(union > 0, (predicted & target).sum(1) / union.clamp(min=1), 1.0)


def chamfer(predicted: Tensor, target: Tensor) -> Tensor:
    """The chamfer distance [B] float32 between the surfaces of voxels [B, S, S, S] bool, in units of the frame.

    The surface is the filled voxels with an empty one beside them, or the grid's border; the distance is the mean, over
    those of one and of the other, from the centre of each to the nearest centre of the other's, both added up (Fan, Su
    and Guibas, "A point set generation network", 2017, without squares). Where only one has any voxel it is √3, the
    diagonal of the box. Either may be a batch of 1 beside the other's B.
    """
    size = predicted.shape[-1]
    outer, inner = _shell(predicted), _shell(target)
    total = torch.zeros(max(len(predicted), len(target)), device=predicted.device)
    for one, other in ((outer, inner), (inner, outer)):
        count = one.flatten(1).sum(1)
        far = torch.where(one, distances(other).clamp(max=size * 2), 0.0).flatten(1).sum(1)
        total = total + torch.where(count > 0, far / count.clamp(min=1), 0.0)
    empty = outer.flatten(1).any(1) != inner.flatten(1).any(1)
    return torch.where(empty, math.sqrt(3), total / (size - 1))


def _shell(voxels: Tensor) -> Tensor:
    """The filled voxels that have an empty one beside them."""
    inner = voxels.clone()
    for axis in (1, 2, 3):
        size = voxels.shape[axis]
        inner.narrow(axis, 0, 1).fill_(False)
        inner.narrow(axis, size - 1, 1).fill_(False)
        inner.narrow(axis, 1, size - 1).logical_and_(voxels.narrow(axis, 0, size - 1))
        inner.narrow(axis, 0, size - 1).logical_and_(voxels.narrow(axis, 1, size - 1))
    return voxels & ~inner


def _grid(vertices: Tensor, size: int) -> Tensor:
    return vertices * (size - 1) + size / 2


def _published_axes(filled: Tensor) -> Tensor:
    return filled.transpose(1, 2).flip(3)


def surface(voxels: Tensor) -> tuple[Tensor, Tensor]:
    """The sides between filled and empty voxels [S, S, S] bool as a mesh in the frame of reconstruction.

    Returns vertices float32 [V, 3] and faces int64 [F, 3], two a side, outward; the vertices belong to one side each.
    """
    size = len(voxels)
    padded = torch.zeros((size + 2,) * 3, dtype=torch.bool, device=voxels.device)
    padded[1:-1, 1:-1, 1:-1] = voxels.flip(2).transpose(0, 1)  # the axes (x, y, z)
    square = torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=torch.float32, device=voxels.device)
    corners = []
    for axis in range(3):
        for side in (0, 1):
            beyond = padded.roll(1 - 2 * side, axis)
            place = (padded & ~beyond).nonzero().float() - 1
            offset = torch.zeros(4, 3, device=voxels.device)
            offset[:, axis] = side
            # Counter-clockwise seen from +axis; the other way round seen from −axis.
            offset[:, (axis + 1) % 3], offset[:, (axis + 2) % 3] = (square if side else square.flip(1)).unbind(1)
            corners.append(place[:, None] + offset)
    vertices = torch.cat(corners).reshape(-1, 3)
    first = 4 * torch.arange(len(vertices) // 4, device=voxels.device)[:, None]
    order = torch.tensor([[0, 1, 2], [0, 2, 3]], device=voxels.device)
    return (vertices - size / 2) / (size - 1), (first[:, None] + order).reshape(-1, 3)
