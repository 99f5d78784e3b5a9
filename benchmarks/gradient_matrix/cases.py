"""The scenes of the matrix: one for each way in which a picture changes when vertices move."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

import neural_renderer as nr

DISTANCE = 4.0  # of the camera, in world units; half an image is one unit wide at the origin
FAR = 6.0  # depth of the background


@dataclass(frozen=True)
class Case:
    """A scene, and directions in which its vertices move.

    Attributes:
        mesh: UVMesh, whose ``image_index`` is −1 where faces have colours of their own.
        motions: Directions [K, V, 3] float32; each moves vertices by about a pixel.
        step: Of the central differences, in units of the motions.
        size: Side of the image in pixels.
        samples: How many times as many shifts the case needs as others; small faces are noisy.
    """

    mesh: nr.UVMesh
    motions: Tensor
    step: float = 0.1
    size: int = 40
    samples: int = 1

    def camera(self) -> nr.Camera:
        """Look at the origin from the front."""
        angle = math.degrees(math.atan(1 / DISTANCE))
        return nr.Camera.look_at((0.0, 0.0, -DISTANCE), viewing_angle=angle)


def cases() -> dict[str, Callable[[], Case]]:
    """List the functions that make the cases, by name."""
    return {
        "large faces": partial(_ball, 0, 129),
        "5 px faces": partial(_ball, 1, 398),
        "3 px faces": partial(_ball, 2, 107),
        "1 px faces": partial(_ball, 4, 0, samples=4),
        "seams, large faces": partial(_ball, 0, 129, seams=True),
        "seams, 5 px faces": partial(_ball, 1, 398, seams=True),
        "seams, 3 px faces": partial(_ball, 2, 107, seams=True, samples=2),
        "seams, 1.4 px faces": partial(_ball, 3, 191, seams=True, samples=4),
        "seams of a sheet": _sheet,
        "hard texture": _checkers,
        "crossing planes": _crossing,
        "intersecting bodies": _intersecting,
        "overlap, near moves": partial(_overlap, near=True),
        "overlap, far moves": partial(_overlap, near=False),
        "outline over the border": partial(_ball, 2, 107, at=(0.93, 0.41, 0.0)),
        "outline along the border": _frame,
    }


def turned(points: Tensor, seed: int = 0) -> Tensor:
    """Turn points [N, 3] by a random rotation."""
    generator = torch.Generator().manual_seed(seed)
    axis = torch.randn(3, generator=generator)
    x, y, z = axis.tolist()
    return points @ torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])).T


def motions_of(vertices: Tensor, size: int = 40, free: int = 0) -> Tensor:
    """Make directions [K, V, 3]: translations, rotations, waves over the scene, and ``free`` ones that are random.

    The vertices of a curved outline do not move each by itself: where three of them are nearly in line, the outline has
    a kink within the step of a difference.
    """
    generator = torch.Generator().manual_seed(1)
    axes, centered = torch.eye(3), vertices - vertices.mean(0)
    motions = [axis.expand(len(vertices), 3) for axis in axes]
    motions += [torch.cross(axis.expand(len(vertices), 3), centered, dim=1) for axis in axes]
    for _ in range(3):
        wave, phase = 1.5 * torch.randn(3, 3, generator=generator), 7 * torch.rand(3, generator=generator)
        motions.append((vertices @ wave + phase).sin())
    motions += [torch.randn(len(vertices), 3, generator=generator) for _ in range(free)]
    return torch.stack(motions) * 2 / size


def _mesh(
    vertices: Tensor,
    faces: Tensor,
    uv: Tensor,
    colors: Tensor,
    image: Tensor | None = None,
    index: Tensor | None = None,
) -> nr.UVMesh:
    images = () if image is None else (image,)
    index = torch.full((len(faces),), 0 if images else -1) if index is None else index
    return nr.UVMesh(vertices, faces, uv, index, images, colors, ("repeat",) * len(images))


def smooth_colors(points: Tensor, seed: int = 2) -> Tensor:
    """Compute colours [..., 3] in [0.1, 0.9] that vary over the scene."""
    wave = 2 * torch.randn(3, 3, generator=torch.Generator().manual_seed(seed))
    return 0.5 + 0.4 * (points @ wave).sin()


def _ball(
    level: int,
    seed: int,
    radius: float = 0.72,
    at: tuple[float, float, float] = (0.013, 0.021, 0.0),
    *,
    seams: bool = False,
    samples: int = 1,
) -> Case:
    """Make a ball with smooth colours and texture coordinates; with ``seams``, both jump at each edge.

    The ``seed`` of its orientation is one of hundreds for which no three vertices of the outline are nearly in line.
    """
    vertices, faces = nr.icosphere(level)
    vertices = turned(vertices, seed)
    corners = vertices[faces.long()]
    colors, uv = smooth_colors(corners), 0.5 + 0.4 * corners[..., :2]
    if seams:
        colors, uv = _random_colors(faces), 0.5 * uv + 0.5 * _random_colors(faces)[..., :2]
    vertices = vertices * radius + torch.tensor(at)
    mesh = _mesh(vertices, faces, uv, colors)
    edge = (corners[:, 0] - corners[:, 1]).norm(dim=-1).mean() * radius * 20
    return Case(mesh, motions_of(vertices), min(0.1, 0.05 * float(edge)), samples=samples)


def _random_colors(faces: Tensor) -> Tensor:
    return torch.rand(len(faces), 1, 3, generator=torch.Generator().manual_seed(3)).expand(-1, 3, -1).contiguous()


def _parts(parts: list[nr.UVMesh]) -> nr.UVMesh:
    counts = torch.tensor([0] + [len(part.vertices) for part in parts]).cumsum(0).tolist()
    vertices = torch.cat([part.vertices for part in parts])
    faces = torch.cat([part.faces + count for part, count in zip(parts, counts[:-1], strict=True)])
    return _mesh(vertices, faces, torch.cat([part.uv for part in parts]), torch.cat([part.colors for part in parts]))


def _plane(corners: list[tuple[float, float, float]], seed: int) -> nr.UVMesh:
    vertices = torch.tensor(corners)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    own = vertices[faces]
    return _mesh(vertices, faces, 0.5 + 0.3 * own[..., :2] + 0.07 * seed, smooth_colors(own, seed))


def _crossing() -> Case:
    """Make two open planes that cross along a line through the picture."""
    one = _plane([(-0.71, -0.62, -0.5), (0.72, -0.75, 0.5), (0.73, 0.63, 0.5), (-0.72, 0.76, -0.5)], 2)
    other = _plane([(-0.61, -0.73, 0.55), (0.63, -0.71, -0.45), (0.62, 0.73, -0.55), (-0.54, 0.72, 0.45)], 5)
    mesh = _parts([one, other])
    return Case(mesh, motions_of(mesh.vertices, free=3), samples=2)


def _overlap(near: bool) -> Case:
    """Make two balls, one before the other, of which one moves."""
    front, back = _ball(2, 23, 0.42, (-0.21, 0.13, -0.7)).mesh, _ball(2, 211, 0.62, (0.19, -0.14, 0.6)).mesh
    back = back.replace(colors=1 - back.colors, uv=1 - back.uv)
    mesh = _parts([front, back])
    motions = motions_of(mesh.vertices)
    moves = torch.zeros(len(mesh.vertices), 1)
    moves[: len(front.vertices)] = float(near)
    moves[len(front.vertices) :] = float(not near)
    return Case(mesh, motions * moves)


def _intersecting() -> Case:
    """Make two balls that intersect."""
    one, other = _ball(2, 232, 0.55, (-0.23, 0.08, -0.1)).mesh, _ball(2, 24, 0.51, (0.24, -0.11, 0.1)).mesh
    other = other.replace(colors=1 - other.colors, uv=1 - other.uv)
    mesh = _parts([one, other])
    return Case(mesh, motions_of(mesh.vertices), samples=2)


def _frame() -> Case:
    """Make a square whose sides run along the border, 0.4 pixels inside it."""
    side = 1 - 0.4 * 2 / 40
    mesh = _plane([(-side, -side, 0.0), (side, -side, 0.0), (side, side, 0.0), (-side, side, 0.0)], 2)
    motions = torch.stack((torch.eye(3)[0].expand(4, 3), torch.eye(3)[1].expand(4, 3), mesh.vertices)) * 2 / 40
    return Case(mesh, motions)


def _sheet() -> Case:
    """Make a flat sheet of triangles of 5 pixels in random colours, whose vertices move each by itself."""
    vertices, uv, faces = _grid(6)
    return Case(_mesh(vertices, faces, uv[faces], _random_colors(faces)), motions_of(vertices, free=6), samples=2)


def _checkers() -> Case:
    """Make a wavy sheet with checkers whose edges are 0.2 pixels wide."""
    vertices, uv, faces = _grid(8)
    vertices = vertices + 0.1 * (5 * uv[:, :1]).sin() * torch.tensor([0.0, 0.0, 1.0])
    texels = torch.arange(512) // 64 % 2
    image = (0.2 + 0.6 * (texels[:, None] ^ texels)).float()[..., None].expand(-1, -1, 3).contiguous()
    return Case(_mesh(vertices, faces, uv[faces], torch.ones(len(faces), 3, 3), image), motions_of(vertices, free=3))


def _grid(count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Make a turned flat grid: vertices, texture coordinates in [0, 1]² and faces."""
    row, column = torch.meshgrid(torch.arange(count + 1), torch.arange(count + 1), indexing="ij")
    uv = torch.stack((column, row), -1).view(-1, 2) / count
    flat = 1.4 * uv - 0.7
    vertices = torch.nn.functional.pad(flat @ torch.tensor([[0.96, 0.28], [-0.28, 0.96]]), (0, 1))
    at = (row * (count + 1) + column)[:-1, :-1].flatten()
    below = torch.stack((at, at + 1, at + count + 2), 1)
    above = torch.stack((at, at + count + 2, at + count + 1), 1)
    return vertices, uv, torch.cat((below, above))
