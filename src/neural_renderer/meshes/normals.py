"""Smooth normals, to be interpolated over faces."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from .. import validate
from ..raster.rasterize import checked_faces, vertices_to_faces


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals at vertices: of the faces around each the mean, weighted by area.

    vertices: [V, 3] or [B, V, 3] floating. faces: [F, 3] or [B, F, 3] integer; rows of -1 are no faces.

    Returns [B, V, 3] float32 (B = 1 for one mesh), on the side from which corners run counter-clockwise in a
    right-handed world; 0 at vertices without faces of any area. Differentiable in vertices. Interpolated over a face
    they are shorter than 1: normalise them in each pixel. Raises TypeError or ValueError for other types or shapes.

    >>> mesh = Mesh.icosphere()
    >>> seen = fragments(mesh, Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30), 64)
    >>> normals = functional.normalize(seen.interpolate(vertex_normals(mesh.vertices, mesh.faces)), dim=-1)
    """
    points = validate.vertices(vertices)
    faces = checked_faces(faces)
    corners = vertices_to_faces(points if points.dim() == 3 else points[None], faces)
    batch, count = len(corners), vertices.shape[-2]
    v0, v1, v2 = corners.unbind(2)
    normals = torch.linalg.cross(v1 - v0, v2 - v0)  # of length twice the area
    faces = faces.expand(batch, -1, -1).long().clamp(min=0)
    first = count * torch.arange(batch, device=faces.device)
    places = (faces + first[:, None, None]).reshape(-1)
    sums = normals.new_zeros(batch * count, 3).index_add(0, places, normals.repeat_interleave(3, 1).reshape(-1, 3))
    return functional.normalize(sums.view(batch, count, 3), dim=-1, eps=1e-20)


def face_normals(corners: Tensor) -> Tensor:
    """Unit normals of faces: corners [..., 3, 3] → [..., 3], along (v0 − v1) × (v2 − v1), as in the published code.

    This is the side from which the corners run **clockwise** in a right-handed world. A face without area has a
    normal shorter than 1, down to zero; values and gradients are finite.
    """
    v0, v1, v2 = corners.unbind(-2)
    a, b = v0 - v1, v2 - v1
    normal = torch.linalg.cross(a, b, dim=-1)
    # The published floor of 1e-5 is an area: alone it would darken the small faces of a fine mesh. Measured against
    # the face's own size it only catches slivers, and for faces larger than a unit it is the published one.
    size = torch.maximum((a * a).sum(-1, keepdim=True), (b * b).sum(-1, keepdim=True)).detach()
    floor = 1e-5 * size.clamp(1e-12, 1)
    return normal / torch.maximum(torch.linalg.vector_norm(normal, dim=-1, keepdim=True), floor)
