"""Closest points on a mesh."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ....base import validate
from ....meshes.bounds import bounding_box
from ....meshes.normals import face_normals
from .nearest import NearestFaces
from .sample_points import SurfacePoints, checked_surface


def closest_points(mesh: Any, points: Tensor) -> SurfacePoints:
    """Find the closest point on a mesh for each of N points, for example for the distance between two surfaces.

    Warp's bounding volume hierarchy finds the faces, on the CPU, in float32 relative to the mesh's size.

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
        index, weights = ClosestFaces(vertices, faces).closest(points.detach())
    corners = vertices[faces[index]]
    return SurfacePoints((weights[..., None] * corners).sum(1), -face_normals(corners), index, weights, faces)


class ClosestFaces:
    """Search for the closest points of the faces [F, 3] int64, F ≥ 1, of a mesh."""

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        self._vertices, self._faces = vertices, faces
        self._center, half = bounding_box(vertices.double())
        self._half = half or 1.0
        self._search = NearestFaces(self._moved(vertices), faces)

    def project(self, points: Tensor) -> Tensor:
        """Find the closest points [N, 3] on the mesh."""
        index, weights = self.closest(points)
        return (weights[..., None] * self._vertices[self._faces[index]]).sum(1)

    def closest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Find the face [N] and the weights [N, 3] of its corners at the closest point for each of N points."""
        index = self._search.closest(self._moved(points).cpu())[0].to(points.device)
        return index, _closest_on_faces(points, self._vertices[self._faces[index]])

    def _moved(self, points: Tensor) -> Tensor:
        """Move the mesh to [−1, 1]³."""
        return ((points.double() - self._center) / self._half).float()


def _closest_on_faces(points: Tensor, corners: Tensor) -> Tensor:
    """Find the closest point to each of N points on its own face [N, 3, 3]: weights [N, 3]."""
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
    return torch.where(inside[:, None], inner / inner.sum(1, keepdim=True).clamp(min=1e-30), weights)
