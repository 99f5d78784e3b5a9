"""Shapes to begin with. All have outward counter-clockwise faces, y up, and the origin in the middle."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .. import validate


def icosphere(level: int = 3, radius: float = 1.0) -> tuple[Tensor, Tensor]:
    """A sphere: vertices float32 [10·4ˡ + 2, 3], faces int32 [20·4ˡ, 3], where l is the level.

    An icosahedron, its poles on the y axis and a mirror plane at z = 0, has each edge cut into 2ˡ equal parts, and the
    points are pushed out onto the sphere. Level 3 is the usual template of single-image reconstruction to 1e-5: 642
    vertices and 1280 faces; exactly 4, 40 and 32 vertices have x, y and z = 0, where the published file, written with
    six decimals, has 4, 33 and 30. Raises TypeError or ValueError for a level outside [0, 8] or a radius not above 0.
    """
    level, radius = validate.whole("level", level, 0), validate.positive("radius", radius)
    if level > 8:
        raise ValueError(f"level: expected 0 to 8, got {level}")
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
        vertices, faces = _subdivide(vertices, faces)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices[np.abs(vertices) < 1e-12] = 0
    return _mesh(vertices * radius, faces)


def _subdivide(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each face in four, at the middles of its edges."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[edges].mean(axis=1)
    a, b, c = faces.T
    ab, bc, ca = inverse.reshape(-1, 3).T + len(vertices)
    children = [np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([vertices, middle]), np.stack(children, axis=1).reshape(-1, 3)


def cube(size: float = 2.0) -> tuple[Tensor, Tensor]:
    """A cube of this side: vertices float32 [8, 3], faces int32 [12, 3]. TypeError or ValueError unless size > 0."""
    size = validate.positive("size", size)
    vertices = np.array(list(np.ndindex(2, 2, 2))) - 0.5  # vertex 4x + 2y + z
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return _mesh(vertices * size, quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))


def torus(radius: float = 0.7, tube: float = 0.3, segments: int = 48, sides: int = 24) -> tuple[Tensor, Tensor]:
    """A ring around the y axis: vertices float32 [segments·sides, 3], faces int32 [2·segments·sides, 3].

    ``radius`` reaches from the axis to the middle of the tube, whose own radius is ``tube``. TypeError or
    ValueError unless radius > 0, tube > 0 and both counts are at least 3.
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
