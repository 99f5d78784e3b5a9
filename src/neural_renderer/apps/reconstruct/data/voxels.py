"""Voxelisation in the axes of the published data set, and measures on voxels."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ....base import validate
from ....optim.metrics import silhouette_iou
from ....raster.ops.voxels import distances, fill
from .framing import GRID
from .inside import inside

_SPACING = 0.25  # distance of points on a model's faces, in voxels: parts thinner than a voxel are not lost


def voxelize(vertices: Tensor, faces: Tensor, size: int = GRID) -> Tensor:
    """Voxelise predicted meshes like the published evaluation: the surface and the volume that it encloses.

    Vertices [B, V, 3] floating are in the reconstruction frame; parts outside of [−0.5, 0.5]³ are cut off. The result,
    [B, size, size, size] bool, has the axes (y, x, −z) of the published ``_voxels.npz``. The centre of voxel i along an
    axis is at (i − (size − 1)/2)/(size − 1). See `raster.ops.voxels.fill` for the algorithm.
    """
    validate.floating("vertices", vertices, ["B", "V", 3])
    faces = validate.indices("faces", faces, ["F", 3])
    validate.same_device(vertices=vertices, faces=faces)
    validate.finite("vertices", vertices)
    validate.in_range("faces", faces, vertices.shape[1])
    size = validate.whole("size", size, 2)
    return _published_axes(fill(_to_grid(vertices.detach().float(), size), faces.int(), size))


def voxelize_model(vertices: Tensor, faces: Tensor, size: int = GRID) -> Tensor:
    """Voxelise a model as ground truth: the voxels of its surface and of its interior, with the axes of `voxelize`.

    Parts thinner than a voxel are kept. Models with holes are filled: the interior is the enclosed volume and the
    points with a generalised winding number above one half. Inverted winding is detected by the sign of the volume.
    Faces are clockwise seen from outside, because the frame is mirrored.
    """
    validate.floating("vertices", vertices, ["V", 3])
    faces = validate.indices("faces", faces, ["F", 3])
    validate.finite("vertices", vertices)
    validate.in_range("faces", faces, len(vertices))
    points = _to_grid(vertices.detach().cpu().float(), size)
    outward = faces.cpu().int().flip(1)
    filled = fill(points[None], outward, size, _SPACING)[0]
    corners = points[outward.long()] - size / 2
    if float(torch.linalg.det(corners.double()).sum()) < 0:
        outward = outward.flip(1)
    empty = (~filled).nonzero()
    wound = inside(points, outward, empty.float() + 0.5)
    filled[tuple(empty[wound].T)] = True
    return _published_axes(filled[None])[0]


def voxel_centers() -> Tensor:
    """Compute the centres [32768, 3] of voxels in the published axes (y, −z, x), in the frame of the models."""
    place = (torch.arange(GRID) - (GRID - 1) / 2) / (GRID - 1)
    y, z, x = torch.meshgrid(place, -place, place, indexing="ij")
    return torch.stack((x, y, z), -1).reshape(-1, 3)


def voxel_iou(predicted: Tensor, target: Tensor) -> Tensor:
    """Compute the IoU [B] float32 of voxels [B, S, S, S] bool; it is 1 if both are empty."""
    return silhouette_iou(predicted.flatten(2), target.flatten(2))


def chamfer(predicted: Tensor, target: Tensor) -> Tensor:
    """Compute the chamfer distance [B] between the surfaces of voxels [B or 1, S, S, S], in the reconstruction frame.

    The surface is the set of filled voxels with an empty neighbour or at the border of the grid. The distance is the
    mean distance from each surface voxel to the nearest one of the other surface, summed over both directions (Fan, Su
    and Guibas, "A point set generation network", 2017, without squares). It is √3, the diagonal of the box, if one of
    the two is empty.
    """
    size = predicted.shape[-1]
    first, second = _shell(predicted), _shell(target)
    total = torch.zeros(max(len(predicted), len(target)), device=predicted.device)
    for one, other in ((first, second), (second, first)):
        count = one.flatten(1).sum(1)
        distance = torch.where(one, distances(other).clamp(max=size * 2), 0.0).flatten(1).sum(1)
        total = total + torch.where(count > 0, distance / count.clamp(min=1), 0.0)
    empty = first.flatten(1).any(1) != second.flatten(1).any(1)
    return torch.where(empty, math.sqrt(3), total / (size - 1))


def _shell(voxels: Tensor) -> Tensor:
    """Select the filled voxels with an empty neighbour or at the border of the grid."""
    inner = voxels.clone()
    for axis in (1, 2, 3):
        size = voxels.shape[axis]
        inner.narrow(axis, 0, 1).fill_(False)
        inner.narrow(axis, size - 1, 1).fill_(False)
        inner.narrow(axis, 1, size - 1).logical_and_(voxels.narrow(axis, 0, size - 1))
        inner.narrow(axis, 0, size - 1).logical_and_(voxels.narrow(axis, 1, size - 1))
    return voxels & ~inner


def _to_grid(vertices: Tensor, size: int) -> Tensor:
    """Convert positions in the reconstruction frame to voxel coordinates."""
    return vertices * (size - 1) + size / 2


def _published_axes(filled: Tensor) -> Tensor:
    """Convert voxels [B, S, S, S] from the axes (x, y, z) to (y, x, −z)."""
    return filled.transpose(1, 2).flip(3)


def voxel_surface(voxels: Tensor) -> tuple[Tensor, Tensor]:
    """Make a mesh of the squares between filled and empty voxels [S, S, S] bool, in the published axes.

    Returns vertices [V, 3] float32 in the reconstruction frame, and outward faces [F, 3] int64. A square has two faces
    and four vertices; squares share no vertices.
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
            # Counter-clockwise seen from +axis; clockwise from −axis.
            offset[:, (axis + 1) % 3], offset[:, (axis + 2) % 3] = (square if side else square.flip(1)).unbind(1)
            corners.append(place[:, None] + offset)
    vertices = torch.cat(corners).reshape(-1, 3)
    first = 4 * torch.arange(len(vertices) // 4, device=voxels.device)[:, None]
    order = torch.tensor([[0, 1, 2], [0, 2, 3]], device=voxels.device)
    return (vertices - size / 2) / (size - 1), (first[:, None] + order).reshape(-1, 3)
