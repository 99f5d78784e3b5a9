"""Operations on meshes: attributes of faces at pixels, points on the surface, and spheres."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ....meshes.primitives import icosphere
from ...common.geometry.sample_points import sample_points
from .meshes import Meshes


def interpolate_face_attributes(pix_to_face: Tensor, barycentric_coords: Tensor, face_attributes: Tensor) -> Tensor:
    """Interpolate attributes [F, 3, C] of corners at faces [N, H, W, K]; 0 where there is no face."""
    corners = face_attributes[pix_to_face.clamp(min=0)]
    values = (barycentric_coords[..., None] * corners).sum(-2)
    return torch.where(pix_to_face[..., None] < 0, 0.0, values)


def sample_points_from_meshes(
    meshes: Meshes, num_samples: int = 10000, return_normals: bool = False, return_textures: bool = False
) -> Any:
    """Sample points [N, P, 3] uniformly by area, and their normals [N, P, 3]."""
    if return_textures:
        raise NotImplementedError("sample_points_from_meshes(return_textures=True): not in neural-renderer run")
    pairs = zip(meshes.verts_list(), meshes.faces_list(), strict=True)
    found = [sample_points(pair, num_samples) for pair in pairs]
    points = torch.stack([each.points for each in found])
    return (points, torch.stack([each.normals for each in found])) if return_normals else points


def ico_sphere(level: int = 0, device: Any = None) -> Meshes:
    """Make a sphere of radius 1, with as many vertices and faces as PyTorch3D's; the vertices lie elsewhere."""
    vertices, faces = icosphere(level)
    return Meshes([vertices.to(device)], [faces.to(device)])
