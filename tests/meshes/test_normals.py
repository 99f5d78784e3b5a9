"""Normals at vertices."""

from __future__ import annotations

import pytest
import torch
from torch.autograd import gradcheck

import neural_renderer as nr
from tests.rounding import rounding


def test_a_sphere_has_its_own_points_as_normals(device):
    mesh = nr.Mesh.icosphere(4).to(device)
    normals = nr.vertex_normals(mesh.vertices, mesh.faces)
    assert normals.shape == (1, mesh.num_vertices, 3)
    assert (normals[0] - mesh.vertices).norm(dim=1).max() < 0.01


def test_faces_count_by_area():
    vertices = torch.tensor([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 1]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [-1, -1, -1]])
    normals = nr.vertex_normals(vertices, faces)[0]
    torch.testing.assert_close(normals[0], torch.tensor([1.0, 0, 2]) / 5**0.5)
    torch.testing.assert_close(normals[1], torch.tensor([0.0, 0, 1]))
    batch = nr.vertex_normals(torch.stack((vertices, 3 * vertices)), torch.stack((faces, faces.flip(1))))
    torch.testing.assert_close(batch, torch.stack((normals, -normals)))


def test_a_vertex_without_faces_has_none():
    vertices = torch.rand(5, 3, requires_grad=True)
    normals = nr.vertex_normals(vertices, torch.tensor([[0, 1, 2]]))
    assert (normals[0, 3:] == 0).all()
    normals.square().sum().backward()
    assert vertices.grad.isfinite().all()


def test_gradient():
    def smooth(vertices):
        v0, v1, v2 = vertices[torch.tensor([[0, 1, 2], [0, 2, 3]])].unbind(1)
        whole = torch.linalg.cross(v1 - v0, v2 - v0).sum(0)
        return whole / whole.norm()

    vertices = torch.rand(4, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    weight = torch.tensor([0.3, -0.5, 0.8])
    found = torch.autograd.grad(
        (nr.vertex_normals(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]))[0, 0] * weight).sum(), vertices
    )[0]
    expected = torch.autograd.grad((smooth(vertices) * weight).sum(), vertices)[0]
    # The length that both divide by is a few tenths, and its square is in the gradient.
    torch.testing.assert_close(found, expected, **rounding(256, float(expected.abs().max())))
    assert gradcheck(smooth, vertices.detach().double().requires_grad_())


def test_float64_is_computed_in_float64():
    vertices, faces = nr.icosphere(1)
    vertices = (vertices.double() * torch.tensor([1.0, 0.7, 0.4])).requires_grad_()
    assert nr.vertex_normals(vertices, faces).dtype == torch.float64
    assert gradcheck(lambda v: nr.vertex_normals(v, faces), vertices)
    padded, rows = nr.batch([nr.Mesh(*nr.icosphere(0)), nr.Mesh(*nr.icosphere(1))])[:2]
    torch.testing.assert_close(nr.vertex_normals(padded.double(), rows).float(), nr.vertex_normals(padded, rows))
    with pytest.raises(ValueError, match="faces: expected indices"):
        nr.vertex_normals(vertices, faces + 1)
