"""Points on surfaces: uniform by area, on their faces, with attributes and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import neural_renderer as nr


def samples(mesh, count):
    return nr.sample_points(mesh, count, torch.Generator().manual_seed(0))


def test_points_lie_on_the_surface() -> None:
    vertices, faces = nr.torus(segments=12, sides=6)
    found = samples((vertices, faces), 500)
    surface = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    # Each point is the one that trimesh computes from the face and the weights; normals are trimesh's.
    expected = trimesh.triangles.barycentric_to_points(surface.triangles[found.face_index], found.weights.numpy())
    np.testing.assert_allclose(found.points, expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.normals, surface.face_normals[found.face_index], rtol=0, atol=1e-5)
    assert (found.weights >= 0).all()
    torch.testing.assert_close(found.weights.sum(1), torch.ones(500))
    assert torch.equal(samples((vertices, faces), 500).points, found.points)


def test_points_are_uniform_by_area() -> None:
    """A square of a large and a small face: coordinates have the mean and variance of the unit square."""
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0.9, 0]])
    faces = torch.tensor([[0, 1, 4], [0, 4, 2], [0, 2, 3]])
    points = samples((vertices, faces), 40000).points[:, :2]
    # Six standard deviations of the mean of 40000 numbers with variance 1/12, and of their squares (variance 4/45).
    assert (points.mean(0) - 1 / 2).abs().max() < 6 * (1 / 12 / 40000) ** 0.5
    assert (points.square().mean(0) - 1 / 3).abs().max() < 6 * (4 / 45 / 40000) ** 0.5
    assert (points.prod(1).mean() - 1 / 4).abs() < 6 * (7 / 144 / 40000) ** 0.5


def test_attributes_and_gradients() -> None:
    mesh = nr.Mesh.icosphere(1).trainable()
    found = samples(mesh, 50)
    corners = mesh.vertices[mesh.faces.long()]
    for attributes in (mesh.vertices, corners):
        torch.testing.assert_close(found.interpolate(attributes), found.points)
    torch.testing.assert_close(found.interpolate(corners.reshape(-1, 3), torch.arange(240).view(80, 3)), found.points)
    found.points.sum().backward()
    expected = torch.zeros(42).index_add(0, mesh.faces[found.face_index].long().flatten(), found.weights.flatten())
    torch.testing.assert_close(mesh.vertices.grad, expected[:, None].expand(-1, 3))
    with pytest.raises(ValueError, match=r"attributes: expected shape \[80, 3, C\]"):
        found.interpolate(corners[1:])
    with pytest.raises(ValueError, match="triangles: expected indices"):
        found.interpolate(mesh.vertices[:5])


def test_errors() -> None:
    vertices, faces = nr.cube()
    for call, sentence in [
        (lambda: nr.sample_points((vertices * 0, faces), 5), "mesh: expected a surface with an area"),
        (lambda: nr.sample_points((vertices, faces[:0]), 5), "mesh: expected a surface with an area"),
        (lambda: nr.sample_points((vertices, faces), 0), "count: expected at least 1"),
        (lambda: nr.sample_points((vertices[None], faces), 5), r"vertices: expected shape \[V, 3\]"),
        (lambda: nr.sample_points((vertices, faces + 1), 5), "faces: expected indices"),
        (lambda: nr.sample_points((vertices * float("nan"), faces), 5), "vertices: expected finite"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            call()
