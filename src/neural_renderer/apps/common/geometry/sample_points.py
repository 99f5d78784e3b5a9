"""Random points on the surface of a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ....base import validate
from ....base.one_line import OneLine
from ....meshes.batch import mesh_parts
from ....meshes.normals import face_normals


@dataclass(frozen=True, eq=False, repr=False)
class SurfacePoints(OneLine):
    """Points on the surface of a mesh.

    Attributes:
        points: [N, 3] floating, differentiable in the vertices.
        normals: [N, 3], unit normals of the points' faces, differentiable, towards the side where corners run
            counter-clockwise.
        face_index: [N] int64, the face of each point.
        weights: [N, 3], barycentric weights of the face's corners.
        faces: [F, 3], vertex indices of the mesh's faces.

    Raises:
        TypeError, ValueError: In `interpolate`, an argument that does not fit.

    Example:
        >>> points = nr.sample_points(nr.Mesh.icosphere(2), 100)
        >>> points.interpolate(torch.rand(162, 8)).shape  # 8 attributes of vertices
        torch.Size([100, 8])
    """

    points: Tensor
    normals: Tensor
    face_index: Tensor
    weights: Tensor
    faces: Tensor

    def interpolate(self, attributes: Tensor, triangles: Tensor | None = None) -> Tensor:
        """Interpolate attributes of vertices, or of the corners of faces, at the points.

        Args:
            attributes: [V, C], or [F, 3, C] for corners, floating.
            triangles: [F, 3], indices into ``attributes`` [V, C], if they are not the faces.

        Returns:
            [N, C], differentiable in the attributes.

        Raises:
            TypeError, ValueError: A type or shape does not fit, or an index is out of range.
        """
        if getattr(attributes, "ndim", 2) == 3:
            values = validate.floating("attributes", attributes, (len(self.faces), 3, "C"))[self.face_index]
        else:
            validate.floating("attributes", attributes, ("V", "C"))
            faces = self.faces if triangles is None else triangles
            faces = validate.indices("triangles", faces, (len(self.faces), 3)).long()
            validate.in_range("triangles", faces, len(attributes))
            values = attributes[faces[self.face_index]]
        return (self.weights.to(values.dtype)[..., None] * values).sum(1)


def sample_points(mesh: Any, count: int, generator: torch.Generator | None = None) -> SurfacePoints:
    """Sample points on a mesh, uniformly by area, for example for a chamfer distance.

    Args:
        mesh: `Mesh`, `UVMesh`, or (vertices [V, 3], faces [F, 3]).
        count: Number of points N, ≥ 1.
        generator: Source of random numbers on the mesh's device; None is torch's own.

    Returns:
        The points, their normals, faces and weights. Gradients reach the vertices, not the choice of faces.

    Raises:
        TypeError, ValueError: A type or shape does not fit, an index is out of range, or the surface has no area.

    Example:
        >>> points = nr.sample_points(nr.Mesh.icosphere(2), 100).points
        >>> points.shape
        torch.Size([100, 3])
    """
    vertices, faces = checked_surface(mesh)
    count = validate.whole("count", count, 1)
    with torch.no_grad():
        a, b, c = vertices[faces].double().unbind(1)
        cumulative = torch.linalg.cross(b - a, c - a, dim=-1).norm(dim=-1).cumsum(0)  # cumulative sum of twice the area
        if not len(faces) or not bool(cumulative[-1] > 0):
            raise ValueError(f"mesh: expected a surface with an area, got {len(faces)} faces of area 0")
        chance, u, v = torch.rand(3, count, generator=generator, dtype=torch.float64, device=vertices.device)
        index = torch.searchsorted(cumulative, chance * cumulative[-1], right=True).clamp(max=len(faces) - 1)
        # Reflect the points of the unit square outside of the triangle into it.
        beyond = u + v > 1
        u, v = torch.where(beyond, 1 - u, u), torch.where(beyond, 1 - v, v)
        weights = torch.stack((1 - u - v, u, v), -1).to(vertices.dtype)
    corners = vertices[faces[index]]
    points, normals = (weights[..., None] * corners).sum(1), -face_normals(corners)  # `face_normals` point inward
    return SurfacePoints(points, normals, index, weights, faces)


def checked_surface(mesh: Any, always: bool = False) -> tuple[Tensor, Tensor]:
    """Check one mesh; return vertices [V, 3] of 32 or 64 bits and faces [F, 3] int64; see `validate.finite`."""
    vertices, faces, _ = mesh_parts(mesh)
    vertices = validate.wide(validate.floating("vertices", vertices, ("V", 3)))
    faces = validate.indices("faces", faces, ("F", 3)).long()
    validate.same_device(vertices=vertices, faces=faces)
    validate.finite("vertices", vertices, always)
    validate.in_range("faces", faces, len(vertices), always)
    return vertices, faces
