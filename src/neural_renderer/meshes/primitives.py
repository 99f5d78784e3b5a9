"""Primitive meshes with outward counter-clockwise faces, y up, centred at the origin."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..base import validate
from .subdivision import split_faces

_MOST_LEVELS = 8  # 655,362 vertices


def icosphere(level: int = 3, radius: float = 1.0) -> tuple[Tensor, Tensor]:
    """Make a sphere by subdividing an icosahedron.

    The poles lie on the y axis and z = 0 is a mirror plane. Every edge of the icosahedron is cut into 2^level parts,
    and the points are projected onto the sphere. Level 3 is the template of the published single-image reconstruction,
    to 1e-5.

    Args:
        level: Number of subdivisions, 0 to 8.
        radius: Radius, > 0.

    Returns:
        Vertices [10·4^level + 2, 3] float32 and faces [20·4^level, 3] int32.

    Raises:
        TypeError, ValueError: ``level`` or ``radius`` is out of range.

    Example:
        >>> vertices, faces = icosphere(level=3)
        >>> vertices.shape, faces.shape
        (torch.Size([642, 3]), torch.Size([1280, 3]))
    """
    level, radius = validate.whole("level", level, 0), validate.positive("radius", radius)
    if level > _MOST_LEVELS:
        raise ValueError(f"level: expected 0 to {_MOST_LEVELS}, got {level}")
    ring = np.arange(5)
    angle = 2 * np.pi * ring / 5
    upper = np.stack([2 * np.cos(angle), np.ones(5), -2 * np.sin(angle)], axis=1) / np.sqrt(5)
    angle = angle + np.pi / 5
    lower = np.stack([2 * np.cos(angle), -np.ones(5), -2 * np.sin(angle)], axis=1) / np.sqrt(5)
    vertices = np.concatenate([[[0, 1, 0]], upper, lower, [[0, -1, 0]]])
    a, b = 1 + ring, 1 + (ring + 1) % 5
    c, d = a + 5, b + 5
    top, bottom = np.zeros(5, dtype=np.int64), np.full(5, 11)
    faces = np.concatenate([np.stack(f, axis=1) for f in ((top, a, b), (a, c, b), (c, d, b), (bottom, d, c))])
    for _ in range(level):
        edges, split = split_faces(torch.from_numpy(faces), len(vertices))
        vertices, faces = np.concatenate([vertices, vertices[edges.numpy()].mean(axis=1)]), split.numpy()
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices[np.abs(vertices) < 1e-12] = 0
    return _mesh(vertices * radius, faces)


def cube(size: float = 2.0) -> tuple[Tensor, Tensor]:
    """Make a cube.

    Args:
        size: Side length, > 0.

    Returns:
        Vertices [8, 3] float32 and faces [12, 3] int32.

    Raises:
        TypeError, ValueError: ``size`` is not > 0.

    Example:
        >>> vertices, faces = cube(size=1.0)
        >>> vertices.min().item(), vertices.max().item()
        (-0.5, 0.5)
    """
    size = validate.positive("size", size)
    vertices = np.array(list(np.ndindex(2, 2, 2))) - 0.5  # vertex 4x + 2y + z
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return _mesh(vertices * size, quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))


def torus(radius: float = 0.7, tube: float = 0.3, segments: int = 48, sides: int = 24) -> tuple[Tensor, Tensor]:
    """Make a torus around the y axis.

    Args:
        radius, tube: Distance from the axis to the centre of the tube, and the tube's radius, > 0.
        segments, sides: Number of segments around the axis and around the tube, ≥ 3.

    Returns:
        Vertices [segments · sides, 3] float32 and faces [2 · segments · sides, 3] int32.

    Raises:
        TypeError, ValueError: An argument is out of range.

    Example:
        >>> vertices, faces = torus(segments=16, sides=8)
        >>> vertices.shape, faces.shape
        (torch.Size([128, 3]), torch.Size([256, 3]))
    """
    radius, tube = validate.positive("radius", radius), validate.positive("tube", tube)
    segments, sides = validate.whole("segments", segments, 3), validate.whole("sides", sides, 3)
    i, j = np.indices((segments, sides)).reshape(2, -1)
    around, across = 2 * np.pi * i / segments, 2 * np.pi * j / sides
    distance = radius + tube * np.cos(across)
    vertices = np.stack([distance * np.cos(around), tube * np.sin(across), -distance * np.sin(around)], axis=1)
    right, up = (i + 1) % segments, (j + 1) % sides
    a, b, c, d = i * sides + j, right * sides + j, right * sides + up, i * sides + up
    return _mesh(vertices, np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3))


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> tuple[Tensor, Tensor]:
    return torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(faces.astype(np.int32))
