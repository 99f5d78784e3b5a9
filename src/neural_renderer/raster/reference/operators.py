"""Float64 references of the rasteriser's operators in plain torch, which also draw with ``dtype=torch.float64``.

The tests compare the kernels with them, and with those of `tests/raster/reference`. Arguments are as in the operator of
the same name. Time and memory grow with faces times pixels: use small scenes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..warp.native import constant

NARROWEST = constant("geometry.h", "NARROWEST", float)


class FacesAtPixels(NamedTuple):
    """The F faces of an image at every pixel centre."""

    inside: Tensor  # [F, H, W] bool: the centre is in the face or on its edge
    depth: Tensor  # [F, H, W] float64; undefined outside
    weights: Tensor  # [F, H, W, 3] float64, screen-space barycentric; their sum is 1


def pixel_centres(height: int, width: int, device: torch.device | None = None) -> tuple[Tensor, Tensor]:
    """Compute x and y [H, W] of the pixel centres on the screen, row 0 at the top."""
    x = (2 * torch.arange(width, dtype=torch.float64, device=device) + 1 - width) / width
    y = (2 * torch.arange(height, dtype=torch.float64, device=device) + 1 - height) / height
    return x.expand(height, width), y.flip(0)[:, None].expand(height, width)


def in_camera_space(faces: Tensor) -> Tensor:
    """Convert screen-space corners [..., 3] to camera space; a point (x, y, z) projects to (x/z, y/z)."""
    return torch.cat((faces[..., :2] * faces[..., 2:], faces[..., 2:]), -1)


def sides(faces: Tensor, perspective: bool) -> Tensor:
    """Compute the visible side of faces [..., 3, 3]: 1 for counter-clockwise corners, -1 for clockwise, 0 edge on."""
    faces = faces.double()
    if perspective:
        # The sign of the tetrahedron's volume with the camera. It is also right for corners behind the camera.
        return torch.linalg.det(in_camera_space(faces)).sign()
    a, b = faces[..., 1, :2] - faces[..., 0, :2], faces[..., 2, :2] - faces[..., 0, :2]
    return (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sign()


def barycentrics_reference(
    faces: Tensor, face_index: Tensor, near: float, far: float, perspective: bool
) -> tuple[Tensor, Tensor]:
    """Compute weights [B, H, W, 3] and depth [B, H, W], differentiable in ``faces``; see `barycentrics`."""
    covered = face_index >= 0
    if not faces.shape[1]:
        empty = torch.zeros(face_index.shape, dtype=torch.float64, device=faces.device)
        return empty[..., None].expand(*empty.shape, 3), empty + far
    # Pixels without a face get a regular one, so that nothing divides by zero.
    plain = torch.tensor([[-1.0, -1, 1], [1, -1, 1], [0, 1, 1]], dtype=torch.float64, device=faces.device)
    corners = torch.where(covered[..., None, None], _own(faces.double(), face_index), plain)
    x, y = pixel_centres(face_index.shape[1], face_index.shape[2], faces.device)
    still = degenerate(corners)[..., None, None] & (torch.arange(3, device=faces.device) < 2)
    corners = torch.where(still, corners.detach(), corners)
    flat = sides(corners.detach(), False) == 0
    weights, _ = screen_weights(torch.where(flat[..., None, None], plain, corners), x, y)
    # Weights leave [0, 1] by rounding only, so the clamp has a derivative of 1.
    clamped = torch.where(flat[..., None], 1.0, weights.detach().clamp(0, 1))
    weights = weights + (clamped / clamped.sum(-1, keepdim=True) - weights).detach()
    depth = depth_of(weights, corners, perspective)
    if perspective:
        crossing = (corners[..., 2] <= 0).any(-1)
        hit = hit_faces(torch.where(crossing[..., None, None], corners, plain), x, y)
        weights = torch.where(crossing[..., None], hit.weights, weights)
        depth = torch.where(crossing, hit.depth, depth)
        weights = weights * depth[..., None] / corners[..., 2]
    depth = depth + (depth.detach().clamp(near, far) - depth).detach()
    return torch.where(covered[..., None], weights, 0.0), torch.where(covered, depth, far)


def sample_textures_reference(
    textures: Tensor,
    light: Tensor,
    background: Tensor,
    faces: Tensor,
    face_index: Tensor,
    weights: Tensor,
    eps: float,
    perspective: bool,
) -> Tensor:
    """Sample the colours [B, 3, H, W], differentiable in all arguments but ``faces``; see `sample_textures`."""
    batch, size, covered = len(faces), textures.shape[2], (face_index >= 0)[..., None]
    if not faces.shape[1]:
        return background.double()
    texels = _own(textures.double().expand(batch, *textures.shape[1:]), face_index)
    if textures.dim() == 4:
        blend = torch.einsum("bhwk,bhwkc->bhwc", weights.double(), texels)
    else:
        c = (weights.double() * (size - 1)).clamp(0, max(size - 1 - eps, 0))
        # Tent functions along the three axes: the trilinear blend as a sum over the whole cube.
        tents = (1 - (c[..., None] - torch.arange(size, dtype=torch.float64, device=c.device)).abs()).clamp(min=0)
        blend = torch.einsum("bhwi,bhwj,bhwk,bhwijkc->bhwc", *tents.unbind(-2), texels)
    back = _own((sides(faces, perspective) < 0)[..., None], face_index)
    front_light, back_light = light.double().expand(batch, *light.shape[1:]).unbind(1)
    lit = blend * torch.where(back, _own(back_light, face_index), _own(front_light, face_index))
    return torch.where(covered, lit, background.double().permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


def _own(values: Tensor, face_index: Tensor) -> Tensor:
    """Gather the values [B, F, ...] of the face at each pixel, [B, H, W, ...]; of face 0 if no face is visible."""
    image = torch.arange(len(values), device=values.device)[:, None, None]
    return values[image, face_index.clamp(min=0).long()]


def degenerate(faces: Tensor) -> Tensor:
    """Test in which faces [..., 3, 3] a weight changes by 1 over less than `NARROWEST` along x or y."""
    v = faces.detach()[..., :2]
    arms = v[..., [2, 0, 1], :] - v[..., [1, 2, 0], :]
    area = arms[..., 0, 0] * arms[..., 1, 1] - arms[..., 0, 1] * arms[..., 1, 0]
    return area.abs() <= NARROWEST * arms.abs().amax((-2, -1))


def screen_weights(faces: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Compute screen-space barycentric weights [..., 3] of (x, y) in faces [..., 3, 3], and whether it is inside."""
    v = faces[..., :2] - torch.stack((x, y), -1)[..., None, :]
    a, b = v[..., [1, 2, 0], :], v[..., [2, 0, 1], :]
    areas = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    whole = areas.sum(-1, keepdim=True)
    inside = ((areas >= 0).all(-1) & (whole[..., 0] > 0)) | ((areas <= 0).all(-1) & (whole[..., 0] < 0))
    return areas / torch.where(whole == 0, math.nan, whole), inside


def depth_of(weights: Tensor, faces: Tensor, perspective: bool) -> Tensor:
    """Interpolate depth by screen-space weights [..., 3] of faces [..., 3, 3]."""
    z = faces[..., 2]
    return 1 / (weights / z).sum(-1) if perspective else (weights * z).sum(-1)


def hit_faces(faces: Tensor, x: Tensor, y: Tensor) -> FacesAtPixels:
    """Intersect the rays from the camera through (x, y) with the faces in camera space."""
    p = in_camera_space(faces)
    ray = torch.stack((x, y, torch.ones_like(x)), -1)
    normal = torch.linalg.cross(p[..., 1, :] - p[..., 0, :], p[..., 2, :] - p[..., 0, :])
    depth = (normal * p[..., 0, :]).sum(-1) / (normal * ray).sum(-1)
    arms = p - (depth[..., None] * ray)[..., None, :]
    # Barycentric weights of the hit point in space: ratios of areas.
    parts = (torch.linalg.cross(arms[..., [1, 2, 0], :], arms[..., [2, 0, 1], :]) * normal[..., None, :]).sum(-1)
    shares = parts / (normal * normal).sum(-1, keepdim=True)
    # A screen-space weight is the weight in space times the corner's depth, over the point's depth.
    return FacesAtPixels((shares >= 0).all(-1) & (depth > 0), depth, shares * p[..., 2] / depth[..., None])
