"""Exact closest points on a mesh, by a bounding volume hierarchy."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ....base import validate
from ....meshes.normals import face_normals
from ....meshes.sample_points import SurfacePoints, checked_surface

_BATCH = 32768  # points searched together: a limit of the memory
_BITS = 10  # bits per coordinate in the order of faces along a space-filling curve


def closest_points(mesh: Any, points: Tensor) -> SurfacePoints:
    """Find the closest point on a mesh for each of N points, for example for the distance between two surfaces.

    A tree of bounding boxes, built in the order of a Morton curve, is searched for all points together.

    Args:
        mesh: `Mesh`, `UVMesh`, or (vertices [V, 3], faces [F, 3]).
        points: [N, 3] floating, finite.

    Returns:
        The closest points, their normals, faces and weights, N each. Gradients reach the vertices; the choice of faces
        and weights has none.

    Raises:
        TypeError, ValueError: A type or shape does not fit, an index is out of range, a value is not finite, or the
            mesh has no faces.

    Example:
        >>> found = closest_points(nr.Mesh(*nr.cube()), torch.tensor([[3.0, 0.5, 0.0]]))
        >>> found.points.detach()
        tensor([[1.0000, 0.5000, 0.0000]])
    """
    vertices, faces = checked_surface(mesh)
    points = validate.wide(validate.floating("points", points, ("N", 3))).to(vertices.dtype)
    validate.same_device(vertices=vertices, points=points)
    validate.finite("points", points)
    if not len(faces):
        raise ValueError("mesh: expected at least one face, got none")
    with torch.no_grad():
        index, weights = FaceTree(vertices, faces).closest(points.detach())
    corners = vertices[faces[index]]
    return SurfacePoints((weights[..., None] * corners).sum(1), -face_normals(corners), index, weights, faces)


class FaceTree:
    """Binary tree of boxes around the faces [F, 3] int64, F ≥ 1, of a mesh."""

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        self._vertices, self._indices = vertices, faces
        corners = vertices[faces]
        order = torch.argsort(morton_codes(corners.mean(1)), stable=True)
        depth = max(len(faces) - 1, 0).bit_length()
        self._faces = order[
            torch.arange(2**depth, device=order.device) * len(faces) >> depth
        ]  # leaves; faces appear once or twice
        self._corners = corners[self._faces]
        boxes = torch.cat((self._corners.amin(1), self._corners.amax(1), self._corners.mean(1)), 1)
        self._levels = [boxes]  # corners of boxes, and a point of the surface in each
        for _ in range(depth):
            low, high, middle = boxes.view(-1, 2, 9).split(3, 2)
            boxes = torch.cat((low.amin(1), high.amax(1), middle[:, 0]), 1)
            self._levels.insert(0, boxes)

    def project(self, points: Tensor) -> Tensor:
        """Find the closest points [N, 3] on the mesh."""
        index, weights = self.closest(points)
        return (weights[..., None] * self._vertices[self._indices[index]]).sum(1)

    def closest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Find the face [N] and the weights [N, 3] of its corners at the closest point for each of N points."""
        index, weights = zip(*map(self._search, points.split(_BATCH)), strict=True)
        return torch.cat(index), torch.cat(weights)

    def _search(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Implement `closest` for one batch of points."""
        rows = torch.arange(len(points), device=points.device)
        bound = torch.full_like(points[:, 0], torch.inf)  # upper bound of the squared distance of the closest point
        owner, node = rows, torch.zeros_like(rows)
        for level in range(1, len(self._levels)):
            owner, node = owner.repeat_interleave(2), (2 * node[:, None] + node.new_tensor([0, 1])).flatten()
            low, high, middle = self._levels[level][node].split(3, 1)
            position = points[owner]
            bound = bound.scatter_reduce(0, owner, (middle - position).square().sum(1), "amin")
            distance = torch.maximum(low - position, position - high).clamp(min=0).square().sum(1)
            kept = distance <= bound[owner]
            owner, node = owner[kept], node[kept]
        weights, distance = _closest_on_faces(points[owner], self._corners[node])
        least = torch.full_like(bound, torch.inf).scatter_reduce(0, owner, distance, "amin")
        best = torch.nonzero(distance == least[owner])[:, 0]
        chosen = torch.empty_like(rows).index_copy(0, owner[best].flip(0), best.flip(0))
        return self._faces[node[chosen]], weights[chosen]


def _closest_on_faces(points: Tensor, corners: Tensor) -> tuple[Tensor, Tensor]:
    """Find the closest point to each of N points on its own face [N, 3, 3]: weights [N, 3], squared distances [N]."""
    sides = corners.roll(-1, 1) - corners
    along = ((points[:, None] - corners) * sides).sum(2) / sides.square().sum(2).clamp(min=1e-30)
    along = along.clamp(0, 1)
    on_side = (corners + along[..., None] * sides - points[:, None]).square().sum(2)
    distance, side = on_side.min(1)
    fraction = along.gather(1, side[:, None])
    weights = (
        torch.zeros_like(points).scatter(1, side[:, None], 1 - fraction).scatter(1, (side[:, None] + 1) % 3, fraction)
    )
    normal = torch.linalg.cross(sides[:, 0], sides[:, 1], dim=1)
    square = normal.square().sum(1)
    # Barycentric weights: areas of the triangles that the point forms with the sides, over the face's area.
    inner = (torch.linalg.cross(sides, points[:, None] - corners, dim=2) * normal[:, None]).sum(2)
    inner = inner.roll(-1, 1) / square.clamp(min=1e-30)[:, None]
    height = ((points - corners[:, 0]) * normal).sum(1).square() / square.clamp(min=1e-30)
    inside = (inner >= 0).all(1) & (square > 0) & (height <= distance)
    return torch.where(inside[:, None], inner / inner.sum(1, keepdim=True).clamp(min=1e-30), weights), torch.where(
        inside, height, distance
    )


def morton_codes(points: Tensor) -> Tensor:
    """Interleave the bits of coordinates: nearby points [N, 3] get nearby numbers [N] int64."""
    low, high = points.amin(0), points.amax(0)
    cells = ((points - low) / (high - low).amax().clamp(min=1e-30) * (2**_BITS - 1)).long()
    code = torch.zeros_like(cells[:, 0])
    for bit in range(_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return code
