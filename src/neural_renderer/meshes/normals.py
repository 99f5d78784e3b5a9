"""Vertex normals for smooth shading, and face normals."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from ..raster.faces import checked_faces, corner_indices, vertices_to_faces
from ..raster.ops.flat_light import LARGEST_COORDINATE, SMALLEST_SINE

_TINY = 1e-20  # least divisor of a vertex normal


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Compute area-weighted vertex normals.

    Interpolated normals are shorter than 1; normalise them per pixel.

    Args:
        vertices: [V, 3] or [B, V, 3] floating.
        faces: [F, 3] or [B, F, 3] integer. A row of −1 is padding.

    Returns:
        [B, V, 3] unit vectors (B = 1 for one mesh), float64 for float64 vertices, else float32, on the side where
        corners run counter-clockwise in a right-handed world. A vertex without a face of positive area has normal 0.
        Differentiable in vertices.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> mesh = nr.Mesh.icosphere()
        >>> fragments = nr.fragments(mesh, nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30), 64)
        >>> normals = fragments.interpolate(nr.vertex_normals(mesh.vertices, mesh.faces))
        >>> normals = torch.nn.functional.normalize(normals, dim=-1)
    """
    points = validate.wide(validate.vertices(vertices))
    faces = checked_faces(faces)
    corners = _corners(points if points.dim() == 3 else points[None], faces)
    batch, count = len(corners), vertices.shape[-2]
    v0, v1, v2 = _in_range(corners, (1, 2, 3)).unbind(2)
    normals = torch.linalg.cross(v1 - v0, v2 - v0)  # length: twice the area
    faces = faces.expand(batch, -1, -1).long().clamp(min=0)
    first = count * torch.arange(batch, device=faces.device)
    index = (faces + first[:, None, None]).reshape(-1)
    sums = normals.new_zeros(batch * count, 3).index_add(0, index, normals.repeat_interleave(3, 1).reshape(-1, 3))
    return functional.normalize(sums.view(batch, count, 3), dim=-1, eps=_TINY)


def face_normals(corners: Tensor) -> Tensor:
    """Compute unit normals [..., 3] of corners [..., 3, 3] along (v0 − v1) × (v2 − v1), as the first packages do.

    They point to the side where corners run **clockwise** in a right-handed world. The normal of a degenerate face is
    shorter than 1, down to 0. Values and gradients are finite.
    """
    v0, v1, v2 = _in_range(validate.wide(corners), (-2, -1)).unbind(-2)
    return _unit_cross(v0 - v1, v2 - v1).to(corners.dtype)


def hinge_normals(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Compute `face_normals` of pairs of faces (v0, v1, v2) and (v1, v0, v3), from corners [..., 4, 3] in order."""
    v0, v1, v2, v3 = _in_range(corners, (-2, -1)).unbind(-2)
    side = v0 - v1
    return _unit_cross(side, v2 - v1), _unit_cross(-side, v3 - v0)


def _unit_cross(a: Tensor, b: Tensor) -> Tensor:
    """Divide a × b by its length, or, for slivers, by a larger number."""
    normal = torch.linalg.cross(a, b, dim=-1)
    # The first packages divide by max(area, 1e-5), which darkens the small faces of a fine mesh. Here the floor is
    # relative to the squared edge length: it affects only slivers, and equals theirs for edges longer than 1.
    size = torch.maximum((a * a).sum(-1, keepdim=True), (b * b).sum(-1, keepdim=True)).detach()
    floor = SMALLEST_SINE * size.clamp(1e-12, 1)
    return normal / torch.maximum(torch.linalg.vector_norm(normal, dim=-1, keepdim=True), floor)


def _corners(points: Tensor, faces: Tensor) -> Tensor:
    """Gather the corners of faces, [B, F, 3, 3], from points [B, V, 3] in the dtype of the points."""
    if points.dtype == torch.float32:
        return vertices_to_faces(points, faces)
    indices = corner_indices(points, faces, len(points)).long().clamp(min=0)  # padding becomes a degenerate face
    return points[torch.arange(len(points), device=points.device)[:, None, None], indices]


def _in_range(corners: Tensor, dims: tuple[int, ...]) -> Tensor:
    """Scale large corners down, by one factor over ``dims``, so that squared areas do not overflow."""
    if not all(corners.shape[dim] for dim in dims):
        return corners
    largest = corners.detach().abs().amax(dims, keepdim=True)
    return corners / (largest / LARGEST_COORDINATE).clamp(min=1)
