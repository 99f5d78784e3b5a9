"""Meshes of different size in one batch, and several in one scene."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from tests.rounding import rounding


def shapes(device):
    ball = nr.Mesh.icosphere(2, radius=0.5).to(device)
    vertices, faces = nr.cube()
    generator = torch.Generator().manual_seed(0)
    box = nr.Mesh(0.5 * vertices, faces, torch.rand(len(faces), 2, 2, 2, 3, generator=generator)).to(device)
    return nr.Mesh(ball.vertices, ball.faces, torch.ones(len(ball.faces), 2, 2, 2, 3)).to(device), box


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_a_list_is_drawn_as_each_mesh_alone(device, gradient):
    meshes = list(shapes(device))
    camera = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]], viewing_angle=30).to(device)
    together = nr.render(meshes, camera, 48, gradient=gradient)
    weight = torch.randn(2, 3, 48, 48, generator=torch.Generator().manual_seed(1)).to(device)
    found = torch.autograd.grad((together.rgb * weight).sum(), [m.vertices for m in meshes])
    for b, mesh in enumerate(meshes):
        own = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]][b], viewing_angle=30).to(device)
        alone = nr.render(mesh, own, 48, gradient=gradient)
        for name in ("rgb", "alpha", "depth"):  # the cameras' products are taken in another order; depth is up to 100
            torch.testing.assert_close(getattr(together, name)[b], getattr(alone, name)[0], **rounding(64, 100))
        (expected,) = torch.autograd.grad((alone.rgb[0] * weight[b]).sum(), mesh.vertices)
        # Where an edge passes near a pixel's centre, the pull has this distance in its denominator.
        assert (found[b] - expected).norm() <= 1e-3 * expected.norm()


def test_one_scene(device):
    ball, box = shapes(device)
    vertices, faces, textures = nr.join([ball, box])
    assert faces.amin() == 0 and faces.amax() == len(vertices) - 1
    camera = nr.Camera.look_at((0.3, 1.0, -2.5), viewing_angle=30).to(device)
    alpha = nr.render((vertices, faces, textures), camera, 48, outputs="alpha").alpha
    single = [nr.render(mesh, camera, 48, outputs="alpha").alpha for mesh in (ball, box)]
    assert torch.equal(alpha, torch.maximum(*single))
    alpha.sum().backward()
    assert ball.vertices.grad.any() or box.vertices.grad.any()


def test_no_face_is_minus_one_three_times(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30).to(device)
    filled = torch.cat((faces, faces.new_full((3, 3), -1)))
    expected = nr.render((vertices, faces), camera, 32, outputs="alpha").alpha
    assert torch.equal(nr.render((vertices, filled), camera, 32, outputs="alpha").alpha, expected)
    filled[-1] = torch.tensor([0, 1, -1])
    with pytest.raises(ValueError, match="faces: expected indices in"):
        nr.render((vertices, filled), camera, 32, outputs="alpha")


def test_what_does_not_fit(device):
    ball, box = shapes(device)
    with pytest.raises(TypeError, match="meshes: expected a list of Mesh, got"):
        nr.batch([ball, box.vertices])
    with pytest.raises(ValueError, match="meshes: expected at least one Mesh"):
        nr.join([])
    with pytest.raises(ValueError, match="meshes: expected textures of one size, got 2 and 4"):
        nr.batch([ball, nr.Mesh.icosphere(1, texture_size=4).to(device)])
