"""Procedural models for demonstrations: a rubber duck and a knot, with texture cubes."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from ...io.cubes import bake_corners
from ...meshes.mesh import Mesh
from ..common.geometry.isosurface import isosurface

_EYE, _GLINT = (0.215, 0.56, 0.70), (0.0, 0.035, 0.03)  # centre of an eye, and offset of its highlight
_YELLOW, _ORANGE, _BLACK = (1.0, 0.78, 0.12), (0.96, 0.42, 0.07), (0.07, 0.06, 0.06)


def duck(steps: int = 56, texture_size: int = 4) -> Mesh:
    """Make a closed rubber duck in [-1, 1]³ that looks along +z, with about 6 · steps² faces."""

    def field(p: np.ndarray) -> np.ndarray:
        return _blend(_blend(_plumage(p), _beak(p), 0.04), _tail(p), 0.25)

    vertices, faces = isosurface(field, steps)
    return Mesh(vertices, faces, _duck_color(bake_corners(vertices[faces], texture_size))).normalize()


def _duck_color(p: Tensor) -> Tensor:
    beak = torch.from_numpy(_beak(p.numpy()) < _plumage(p.numpy()) - 0.005)
    from_eye = torch.stack((p[..., 0].abs(), p[..., 1], p[..., 2]), dim=-1) - torch.tensor(_EYE)
    eye = from_eye.norm(dim=-1)
    glint = (from_eye - torch.tensor(_GLINT)).norm(dim=-1)
    color = torch.tensor(_YELLOW).expand(p.shape).clone()
    color[beak] = torch.tensor(_ORANGE)
    color[eye < 0.085] = torch.tensor(_BLACK)
    color[glint < 0.035] = 1.0
    return color


def _plumage(p: np.ndarray) -> np.ndarray:
    """Compute the signed distance of points to body, head and wings."""
    body = _ellipsoid(p, (0, -0.36, -0.05), (0.60, 0.44, 0.78))
    head = _ellipsoid(p, (0, 0.44, 0.38), (0.41, 0.40, 0.41))
    wing = _ellipsoid(np.abs(p) * [1, 0, 0] + p * [0, 1, 1], (0.56, -0.27, -0.12), (0.15, 0.24, 0.42))
    return _blend(_blend(body, head, 0.22), wing, 0.06)


def _beak(p: np.ndarray) -> np.ndarray:
    upper = _ellipsoid(p, (0, 0.40, 0.80), (0.20, 0.075, 0.22))
    lower = _ellipsoid(p, (0, 0.33, 0.76), (0.16, 0.06, 0.18))
    return _blend(upper, lower, 0.03)


def _tail(p: np.ndarray) -> np.ndarray:
    x, y, z = p[..., 0], p[..., 1] + 0.13, p[..., 2] + 0.74
    tilted = np.stack([x, 0.77 * y + 0.64 * z, 0.77 * z - 0.64 * y], axis=-1)  # 40°: its tip points up
    return _ellipsoid(tilted, (0, 0, 0), (0.19, 0.12, 0.34))


def _ellipsoid(p: np.ndarray, center: tuple[float, ...], radii: tuple[float, ...]) -> np.ndarray:
    """Approximate the signed distance of points [..., 3] to an ellipsoid."""
    scaled = np.linalg.norm((p - center) / radii, axis=-1)
    slope = np.linalg.norm((p - center) / np.square(radii), axis=-1)
    return scaled * (scaled - 1) / np.maximum(slope, 1e-9)


def _blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Compute the union of two signed distances with a fillet of this width."""
    near = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - near**3 * width / 6


def knot(segments: int = 320, sides: int = 28, texture_size: int = 4) -> Mesh:
    """Make a trefoil knot in [-1, 1]³ with a helical pattern, of segments along it and sides around the tube."""
    around = torch.arange(segments) * (2 * math.pi / segments)
    across = torch.arange(sides) * (2 * math.pi / sides)

    def center(t: Tensor) -> Tensor:
        return torch.stack((t.sin() + 2 * (2 * t).sin(), t.cos() - 2 * (2 * t).cos(), -1.1 * (3 * t).sin()), dim=-1)

    along = torch.nn.functional.normalize(center(around + 1e-2) - center(around - 1e-2), dim=-1)
    out = center(around) * torch.tensor([1.0, 1.0, 0.0])
    normal = torch.nn.functional.normalize(out - (out * along).sum(-1, keepdim=True) * along, dim=-1)
    binormal = torch.linalg.cross(along, normal)
    ring = across.cos()[None, :, None] * normal[:, None] + across.sin()[None, :, None] * binormal[:, None]
    vertices = (center(around)[:, None] + 0.72 * ring).reshape(-1, 3)
    i, j = (index.reshape(-1) for index in torch.meshgrid(torch.arange(segments), torch.arange(sides), indexing="ij"))
    right, up = (i + 1) % segments, (j + 1) % sides
    a, b, c, d = i * sides + j, right * sides + j, right * sides + up, i * sides + up
    faces = torch.stack((a, c, b, a, d, c), dim=1).reshape(-1, 3)
    # Colours are a function of (u, v), which continue beyond 1 at the seam.
    u, v = torch.stack((i, i + 1, i + 1, i, i, i + 1)), torch.stack((j, j + 1, j, j, j + 1, j + 1))
    uv = torch.stack((u / segments, v / sides), dim=-1).movedim(0, 1).reshape(-1, 3, 2)
    return Mesh(vertices, faces, _ribbon(bake_corners(uv, texture_size))).normalize()


def _ribbon(uv: Tensor) -> Tensor:
    """Compute RGB [..., 3] at points (u, v), in turns along the knot and around the tube."""
    palette = torch.tensor([[0.93, 0.27, 0.32], [0.98, 0.72, 0.26], [0.16, 0.68, 0.62], [0.20, 0.36, 0.72]])
    position = (uv[..., 0] * 12 + uv[..., 1] * 1.0) % 4
    first = position.floor().long().clamp(max=3)
    color = palette[first]
    stripe = ((position - first) < 0.12) | ((position - first) > 0.88)
    return torch.where(stripe[..., None], torch.tensor([0.97, 0.95, 0.90]), color)
