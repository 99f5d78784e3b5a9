"""Shared texels: their number, their continuity, and their values from cubes."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.texels import Texels
from tests.rounding import rounding

CUBE = nr.cube()[1]
BALL = nr.icosphere(1)[1]


def at(cubes: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Sample cubes [F, T, T, T, 3] as the renderer does: trilinear at w · (T − 1) for weights w [F, N, 3]."""
    size = cubes.shape[1]
    place = weights.double() * (size - 1)
    low = place.floor().clamp(0, size - 2).long()
    part = place - low
    face = torch.arange(len(cubes))[:, None]
    total = torch.zeros(*weights.shape[:2], 3, dtype=torch.float64)
    for corner in torch.cartesian_prod(*[torch.arange(2)] * 3):
        share = torch.where(corner.bool(), part, 1 - part).prod(-1)
        i, j, k = (low + corner).unbind(-1)
        total += share[..., None] * cubes.double()[face, i, j, k]
    return total


@pytest.mark.parametrize("size", [3, 4, 7])
@pytest.mark.parametrize("faces", [CUBE, BALL])
def test_texels_are_those_of_corners_edges_and_insides(faces: torch.Tensor, size: int) -> None:
    edges = len(faces) * 3 // 2
    texels = Texels.shared(faces, size)
    inside = (size - 2) * (size - 3) // 2
    assert texels.count == int(faces.max()) + 1 + edges * (size - 2) + len(faces) * inside
    assert torch.allclose(texels.weights.sum(1), torch.ones(size**3), **rounding(8)) and (texels.weights >= 0).all()
    values = torch.rand(texels.count, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(texels.from_cubes(texels.cubes(values)), values)


@pytest.mark.parametrize("size", [3, 4, 7])
def test_no_seam(size: int) -> None:
    texels = Texels.shared(BALL, size)
    cubes = texels.cubes(torch.rand(texels.count, 3, generator=torch.Generator().manual_seed(0)))
    along = torch.linspace(0, 1, 23)
    sides: dict[tuple[int, int], list[torch.Tensor]] = {}
    for corner in range(3):
        weights = torch.zeros(len(BALL), 23, 3)
        weights[..., corner], weights[..., (corner + 1) % 3] = 1 - along, along
        colours = at(cubes, weights)
        for face, row in enumerate(BALL.tolist()):
            start, end = row[corner], row[(corner + 1) % 3]
            key = (min(start, end), max(start, end))
            sides.setdefault(key, []).append(colours[face] if start < end else colours[face].flip(0))
    assert len(sides) == 120 and all(len(pair) == 2 for pair in sides.values())
    for one, other in sides.values():
        torch.testing.assert_close(one, other, **rounding(8))


def test_colours_that_are_linear_on_a_face_are_kept() -> None:
    vertices, faces = nr.icosphere(1)
    texels = Texels.shared(faces, 4)
    grid = torch.cartesian_prod(*[torch.arange(4.0)] * 3)
    grid[0] = 1
    cubes = torch.einsum("gk,fkc->fgc", grid / grid.sum(1, keepdim=True), vertices[faces.long()])
    again = texels.cubes(texels.from_cubes(cubes.reshape(-1, 4, 4, 4, 3)))
    torch.testing.assert_close(again.flatten(1, 3), cubes, **rounding(16))  # means of up to six faces


def test_separate_texels_are_the_cubes() -> None:
    texels = Texels.separate(BALL, 3)
    cubes = torch.rand(80, 3, 3, 3, 3)
    assert texels.count == 80 * 27
    torch.testing.assert_close(texels.cubes(texels.from_cubes(cubes)), cubes)


def test_unknown_texels_are_filled() -> None:
    texels = Texels.shared(torch.cat((BALL, BALL + 42)), 4)  # two balls
    known = torch.zeros(texels.count, dtype=torch.bool)
    known[texels.index[5]] = True
    values = torch.full((texels.count, 3), 9.0)
    values[known] = torch.tensor([0.2, 0.5, 0.7])
    found = texels.fill_unknown(values, known)
    torch.testing.assert_close(found[texels.index[:80]], torch.tensor([0.2, 0.5, 0.7]).expand(80, 10, 3))
    assert (found[texels.index[80:]] == 9).all()  # no texel of that ball is known
    values = torch.rand(texels.count, 3)
    half = torch.rand(texels.count) < 0.5
    assert torch.equal(texels.fill_unknown(values, half)[half], values[half])


def test_no_faces() -> None:
    with pytest.raises(ValueError, match="faces: expected at least one, got none"):
        Texels.shared(BALL[:0], 3)


def test_edges_are_neighbours_on_the_lattice() -> None:
    texels = Texels.shared(BALL, 4)
    edges = texels.edges()
    # A closed surface of 80 · 9 small triangles has 3/2 as many edges; each connects two texels of a face.
    assert len(edges) == 80 * 9 * 3 // 2 and (edges[:, 0] < edges[:, 1]).all()
    assert torch.bincount(edges.reshape(-1)).unique().tolist() == [5, 6]
