"""Primitive shapes are closed, face outwards and have the sizes that they promise."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
import torch

from neural_renderer.io.obj import load_obj
from neural_renderer.meshes.primitives import cube, icosphere, torus
from tests.paths import DATA


def volume(vertices: torch.Tensor, faces: torch.Tensor) -> float:
    return float(torch.linalg.det(vertices[faces.long()].double()).sum() / 6)


@pytest.mark.parametrize(
    ("mesh", "euler", "expected", "tolerance"),
    [(icosphere(0), 2, 2.5362, 1e-3), (icosphere(4, 2.0), 2, 32 / 3 * pi, 0.2), (cube(3.0), 2, 27, 1e-4)]
    + [(torus(0.7, 0.2, 96, 48), 0, 2 * pi**2 * 0.7 * 0.04, 3e-3)],
)
def test_closed_and_outwards(mesh, euler, expected, tolerance):
    vertices, faces = mesh
    assert vertices.dtype == torch.float32 and faces.dtype == torch.int32
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(edges.unique(dim=0)) == len(edges)  # each edge once in each direction
    assert {tuple(e) for e in edges.tolist()} == {tuple(e) for e in edges.flip(1).tolist()}
    assert len(vertices) - len(edges) // 2 + len(faces) == euler
    assert abs(volume(vertices, faces) - expected) < tolerance


@pytest.mark.parametrize("level", range(5))
def test_icosphere_counts(level):
    vertices, faces = icosphere(level, 0.5)
    assert len(vertices) == 10 * 4**level + 2 and len(faces) == 20 * 4**level
    assert torch.allclose(vertices.norm(dim=1), torch.tensor(0.5))


def test_icosphere_is_the_published_template():
    theirs = load_obj(DATA / "mesh_reconstruction/sphere_642.obj", False)[0].numpy()
    vertices, faces = icosphere(3)
    ours = vertices.numpy()
    distance = np.linalg.norm(ours[:, None] - theirs[None], axis=-1)
    assert distance.min(0).max() < 2e-5 and distance.min(1).max() < 2e-5  # their file has five digits
    assert (ours == 0).sum(0).tolist() == [4, 40, 32] and len(faces) == 1280


def test_errors():
    with pytest.raises(ValueError, match="level: expected 0 to 8, got 9"):
        icosphere(9)
    with pytest.raises(ValueError, match="radius: expected a finite number above 0, got -1"):
        icosphere(1, -1)
    with pytest.raises(ValueError, match="segments: expected at least 3, got 2"):
        torus(segments=2)
    for call in (icosphere, cube, torus):
        for wrong in ("a", None, [1.0, 2.0], torch.ones(2)):
            with pytest.raises(TypeError, match=r"^(level|size|radius): expected a number, got"):
                call(wrong)
    with pytest.raises(TypeError, match="sides: expected a whole number, got"):
        torus(sides=3.5)
    assert torch.equal(cube(torch.tensor(2.0))[0], cube()[0]) and torch.equal(icosphere(1.0)[0], icosphere(1)[0])
