"""Normal maps: tangents from texture coordinates, and normals from images in tangent space.

Conventions follow MikkTSpace (Mikkelsen, "Simulation of Wrinkled Surfaces Revisited", 2008) and glTF 2.0: each
corner of a face has a unit tangent t towards larger u, orthogonal to its normal n, and a sign; the bitangent
sign · n × t points to larger v, which is up in the image ("green up").
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from ...base import validate
from ...meshes.normals import vertex_normals
from ...raster.faces import checked_faces
from .planes import cross, planar, unit
from .visible_surface import VisibleSurface

_EPS = 1e-20  # shortest vector that is normalised


def corner_tangents(vertices: Tensor, faces: Tensor, uv: Tensor, normals: Tensor | None = None) -> Tensor:
    """Compute the tangents of faces' corners from texture coordinates, as MikkTSpace does.

    The tangents of faces that share a corner's position, normal, texture coordinates and orientation of uv are
    averaged, each in the plane of the normal and weighted by the angle of the face. Unlike in MikkTSpace, faces without
    area in uv get an arbitrary tangent, not those of their neighbours.

    Args:
        vertices: [V, 3] floating.
        faces: [F, 3] integer.
        uv: [F, 3, 2] floating, texture coordinates of the corners, v up.
        normals: [F, 3, 3] floating, unit normals of the corners; None for `vertex_normals`.

    Returns:
        [F, 3, 4] float32: unit tangents, and the sign of the bitangent. Differentiable in all floating arguments.

    Raises:
        TypeError, ValueError: A type, shape or index does not fit.

    Example:
        >>> square = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
        >>> faces = torch.tensor([[0, 1, 2]])
        >>> nr.corner_tangents(square, faces, square[faces][..., :2])[0, 0]
        tensor([1., 0., 0., 1.])
    """
    vertices = validate.floating("vertices", vertices, ("V", 3)).float()
    faces = validate.indices("faces", faces, ("F", 3)).long()
    validate.in_range("faces", faces, len(vertices))
    uv = validate.floating("uv", uv, (len(faces), 3, 2)).float()
    if normals is None:
        normals = vertex_normals(vertices, checked_faces(faces))[0][faces]
    normals = validate.floating("normals", normals, (len(faces), 3, 3)).float()
    points = vertices[faces]
    tangents, sign = _face_tangents(points, uv)
    projected = _in_plane(tangents[:, None].expand_as(points), normals)
    before, after = (_in_plane(points.roll(shift, 1) - points, normals) for shift in (1, -1))
    sine = torch.linalg.vector_norm(torch.linalg.cross(before, after, dim=-1), dim=-1, keepdim=True)
    cosine = (before * after).sum(-1, keepdim=True)
    # An edge of length 0 has no angle: sine and cosine are 0, where atan2 is not differentiable.
    angle = torch.atan2(sine, torch.where((sine == 0) & (cosine == 0), 1.0, cosine))
    signs = sign[:, None].expand(-1, 3, 1)
    same = torch.cat((points, normals, uv, signs), -1).detach().reshape(-1, 9)
    group = torch.unique(same + 0.0, dim=0, return_inverse=True)[1]
    flat = torch.zeros_like(points).reshape(-1, 3).index_add(0, group, (angle * projected).reshape(-1, 3))
    averaged = _in_plane(flat[group].view_as(points), normals)
    degenerate = averaged.detach().square().sum(-1, keepdim=True) < 0.5
    return torch.cat((torch.where(degenerate, _any_tangent(normals), averaged), signs), -1)


def bumped(surface: VisibleSurface, tangents: Tensor, mapped: Tensor) -> VisibleSurface:
    """Replace the normals of a surface by those of a normal map.

    Args:
        surface: The visible surface.
        tangents: Tangents and signs at every pixel, [B, H, W, 4]: `corner_tangents`, interpolated.
        mapped: Normals in tangent space, [B, H, W, 3]: 2 · RGB − 1 of the map.

    Returns:
        The surface with normals x · tangent + y · bitangent + z · normal, differentiable.
    """
    n = surface.normals * surface.sides  # normals of the fronts
    t, sign = unit(planar(tangents[..., :3])), tangents[..., 3:].contiguous()
    bitangent = sign * cross(n, t)
    x, y, z = planar(mapped).split(1, -1)
    return surface.with_normals((x * t + y * bitangent + z * n) * surface.sides)


def _face_tangents(points: Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the direction of larger u on each face, [F, 3], and the orientation of its uv, [F, 1]: 1 or −1."""
    along, across = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    (u1, v1), (u2, v2) = ((uv[:, k] - uv[:, 0]).unbind(-1) for k in (1, 2))
    area = (u1 * v2 - v1 * u2)[:, None]
    sign = torch.where(area > 0, 1.0, -1.0)
    towards = v2[:, None] * along - v1[:, None] * across
    return _unit(torch.where(area == 0, torch.zeros_like(towards), towards)) * sign, sign.detach()


def _in_plane(vectors: Tensor, normals: Tensor) -> Tensor:
    """Project vectors onto the plane of the normal, as unit vectors."""
    return _unit(vectors - (vectors * normals).sum(-1, keepdim=True) * normals)


def _unit(vectors: Tensor) -> Tensor:
    """Divide vectors by their lengths; vectors shorter than `_EPS` become 0, without a gradient."""
    short = torch.linalg.vector_norm(vectors.detach(), dim=-1, keepdim=True) < _EPS
    known = torch.where(short, torch.ones_like(vectors), vectors)
    return torch.where(short, torch.zeros_like(vectors), functional.normalize(known, dim=-1, eps=_EPS))


def _any_tangent(normals: Tensor) -> Tensor:
    """Choose a unit vector orthogonal to each normal."""
    axis = functional.one_hot(normals.detach().abs().argmin(-1), 3).to(normals)
    return _in_plane(axis, normals)
