"""Parts of generated shapes: closed surfaces through rings of points. y is up, the front is at +z."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....io.files import import_library

Array = np.ndarray
Point = Sequence[float] | Array

CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Signs of x and z at the four corners of a plan."""


@dataclass
class Builder:
    """Collects the parts of a shape.

    Attributes:
        rng: Source of all random choices.
        parts: Vertices [V, 3], faces [F, 3] counter-clockwise from outside, and RGB [3] of each part.
    """

    rng: np.random.Generator
    parts: list[tuple[Array, Array, Array]] = field(default_factory=list)

    def uniform(self, low: float, high: float) -> float:
        """Draw a number from [low, high)."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """Draw True with this probability."""
        return bool(self.rng.random() < probability)

    def color(self) -> Array:
        """Draw a colour: grey, wood or anything."""
        kind = self.rng.random()
        value = self.uniform(0.08, 0.95)
        if kind < 0.35:
            return np.clip(value + self.rng.normal(0, 0.02, 3), 0, 1)
        if kind < 0.6:
            return np.clip(value * np.array([1.0, self.uniform(0.6, 0.85), self.uniform(0.3, 0.65)]), 0, 1)
        return self.rng.uniform(0.03, 0.97, 3)

    def loft(self, rings: Array, color: Array) -> None:
        """Add the closed surface through rings [K, N, 3]; a fan around the centre closes each end."""
        count, sides = rings.shape[:2]
        row, column = np.meshgrid(np.arange(count - 1) * sides, np.arange(sides), indexing="ij")
        a, b = row + column, row + (column + 1) % sides
        c, d = a + sides, b + sides
        first, last = count * sides, count * sides + 1
        edge, beyond = np.arange(sides), (np.arange(sides) + 1) % sides
        top = (count - 1) * sides
        faces = [np.stack((a, b, d), -1).reshape(-1, 3), np.stack((a, d, c), -1).reshape(-1, 3)]
        faces += [np.stack((beyond, edge, np.full(sides, first)), -1)]
        faces += [np.stack((edge + top, beyond + top, np.full(sides, last)), -1)]
        vertices = np.concatenate((rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]))
        triangles = np.concatenate(faces)
        if np.linalg.det(vertices[triangles]).sum() < 0:  # the rings run clockwise
            triangles = triangles[:, ::-1]
        self.parts.append((vertices, triangles, color))

    def box(self, center: Point, size: Point, color: Array, taper: float = 1.0, bevel: float = 0.0) -> None:
        """Add a box; ``taper`` scales its top, ``bevel`` in [0, 1) rounds its four upright edges."""
        ring = outline(16, 2 / (1 - bevel) ** 1.5) if bevel else np.array([[1.0, 1], [1, -1], [-1, -1], [-1, 1]])
        self._stack(center, np.asarray(size, float) / 2, ring, [(1.0, -1.0), (taper, 1.0)], color)

    def cushion(self, center: Point, size: Point, color: Array, power: float = 4.0) -> None:
        """Add a box with all edges rounded: a super-ellipsoid."""
        heights = np.linspace(-1, 1, 7) * 0.999
        widths = (1 - np.abs(heights) ** power) ** (1 / power)
        profile = list(zip(widths, heights, strict=True))
        self._stack(center, np.asarray(size, float) / 2, outline(16, power), profile, color)

    def turned(self, center: Point, profile: Sequence[tuple[float, float]], color: Array, sides: int = 14) -> None:
        """Add a solid of revolution around y; the profile is (radius, height) from the bottom."""
        self._stack(center, np.ones(3), outline(sides), profile, color)

    def _stack(
        self, center: Point, size: Array, ring: Array, profile: Sequence[tuple[float, float]], color: Array
    ) -> None:
        """Add the surface through copies of a ring [N, 2] around y; the profile is (scale, height)."""
        rings = [np.stack((ring[:, 0] * r, np.full(len(ring), y), ring[:, 1] * r), -1) for r, y in profile]
        self.loft(np.stack(rings) * size + np.asarray(center, float), color)

    def rod(self, start: Point, end: Point, radius: float, color: Array, tip: float = 1.0, sides: int = 8) -> None:
        """Add a rod between two points; ``tip`` scales its end."""
        start, end = np.asarray(start, float), np.asarray(end, float)
        along = end - start
        side = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 * np.linalg.norm(along) else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        other = np.cross(along, side) / max(float(np.linalg.norm(along)), 1e-9)
        ring = outline(sides, phase=math.pi / sides)
        disc = ring[:, :1] * side + ring[:, 1:] * other
        self.loft(np.stack((start + radius * disc, end + radius * tip * disc)), color)

    def plate(self, polygon: Array, low: float, high: float, color: Array) -> None:
        """Add a star-shaped polygon [N, 2] of the plane (z, y), extruded along x."""
        z, y = polygon.T
        self.loft(np.stack([np.stack((np.full(len(z), x), y, z), -1) for x in (low, high)]), color)

    def sections(self, stations: Sequence[tuple[float, float, float, float]], color: Array, power: float = 2.0) -> None:
        """Add a hull along z through super-ellipses: z, half width, lowest and highest y of each."""
        ring = outline(16, power)
        rings = []
        for z, half, low, high in stations:
            y = (low + high) / 2 + ring[:, 1] * (high - low) / 2
            rings.append(np.stack((ring[:, 0] * half, y, np.full(len(ring), z)), -1))
        self.loft(np.stack(rings), color)

    def cut(self, since: int) -> None:
        """Remove the last part, and subtract it from the parts from number ``since`` on."""
        tool = _solid(*self.parts.pop()[:2])
        for number, (vertices, faces, color) in enumerate(self.parts[since:], since):
            rest = (_solid(vertices, faces) - tool).to_mesh()
            if len(rest.tri_verts):  # a part that would vanish stays
                self.parts[number] = rest.vert_properties.astype(float), rest.tri_verts.astype(np.int64), color

    def twin(self, since: int) -> None:
        """Mirror the parts from number ``since`` on at the plane x = 0."""
        for vertices, faces, color in self.parts[since:]:
            self.parts.append((vertices * [-1.0, 1, 1], faces[:, ::-1], color))

    def turn(self) -> None:
        """Turn all parts by 180° about the y axis."""
        for vertices, _, _ in self.parts:
            vertices *= [-1.0, 1, -1]

    def lean(self, since: int, angle: float, pivot: tuple[float, float]) -> None:
        """Turn the parts from number ``since`` on about the x axis through the pivot (y, z), in degrees."""
        c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        for vertices, _, _ in self.parts[since:]:
            y, z = vertices[:, 1] - pivot[0], vertices[:, 2] - pivot[1]
            vertices[:, 1], vertices[:, 2] = pivot[0] + c * y - s * z, pivot[1] + s * y + c * z


def _solid(vertices: Array, faces: Array) -> Any:
    """Make a closed surface a solid for booleans."""
    manifold3d = import_library("manifold3d", "to generate shapes")
    return manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))


def outline(sides: int, power: float = 2.0, phase: float = 0.0) -> Array:
    """Make a super-ellipse [N, 2], clockwise; power 2 is a circle, large powers are squares."""
    angle = -2 * math.pi * (np.arange(sides) + 0.5) / sides + phase
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((np.sign(c) * np.abs(c) ** (2 / power), np.sign(s) * np.abs(s) ** (2 / power)), -1)
