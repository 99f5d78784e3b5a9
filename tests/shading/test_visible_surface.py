"""The visible surface in each pixel, held to a sphere and to rays."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import normalize

import neural_renderer as nr

EYE = (0.4, 1.0, -2.5)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_a_sphere_has_the_normals_of_a_sphere(mirrored, turned, device):
    """Also if its corners run the other way round: the visible side is the outer one."""
    vertices, faces = nr.icosphere(4)
    vertices, faces = vertices.to(device), (faces.flip(1) if turned else faces).to(device)
    camera = nr.Camera.look_at(EYE, viewing_angle=30, mirrored=mirrored)
    fragments = nr.fragments((vertices, faces), camera, 32)
    surface, shown = nr.VisibleSurface.of(fragments, (vertices, faces), camera), fragments.mask
    exact = normalize(surface.points, dim=-1)
    # Edges are 0.07 long: points are off the sphere by an eighth of the square, normals by its interpolation.
    assert (surface.points[shown].norm(dim=-1) - 1).abs().max() < 2e-3
    torch.testing.assert_close(surface.normals[shown], exact[shown], rtol=0, atol=5e-3)
    assert (surface.sides[shown] == (-1 if turned else 1)).all()
    torch.testing.assert_close(
        surface.views[shown], normalize(torch.tensor(EYE, device=device) - surface.points, dim=-1)[shown]
    )


def test_from_inside_normals_point_to_the_eye():
    vertices, faces = nr.icosphere(3)
    camera = nr.Camera.look_at((0.0, 0.0, 0.2), at=(0.3, 0.5, -1.0), viewing_angle=45)
    fragments = nr.fragments((vertices, faces), camera, 16)
    surface = nr.VisibleSurface.of(fragments, (vertices, faces), camera)
    assert bool(fragments.mask.all()) and ((surface.normals * surface.views).sum(-1) > 0).all()
    assert ((surface.normals * surface.points).sum(-1) < -0.98).all()


def test_parallel_rays_have_one_direction():
    camera = nr.Camera.look_at(EYE, orthographic=True)
    mesh = nr.Mesh.icosphere(2)
    surface = nr.VisibleSurface.of(nr.fragments(mesh, camera, 16), mesh, camera)
    torch.testing.assert_close(surface.views, normalize(torch.tensor(EYE), dim=0).view(1, 1, 1, 3))


def test_calibrated_cameras_have_an_eye():
    """The same view, given by K, R and t."""
    look = nr.Camera.look_at(EYE, viewing_angle=30)
    R = look.rotation[0] * torch.tensor([[1.0], [-1.0], [1.0]])
    f = 16 / torch.tan(torch.deg2rad(torch.tensor(30.0)))
    K = torch.tensor([[f, 0.0, 16.0], [0.0, f, 16.0], [0.0, 0.0, 1.0]])
    calibrated = nr.Camera.projection(K, R, -R @ look.origin[0], orig_size=32)
    mesh = nr.Mesh.icosphere(2)
    surfaces = [nr.VisibleSurface.of(nr.fragments(mesh, c, 16), mesh, c) for c in (look, calibrated)]
    torch.testing.assert_close(surfaces[0].views, surfaces[1].views, rtol=0, atol=1e-4)


def test_meshes_of_a_batch_have_their_own_surface():
    meshes = [nr.Mesh.icosphere(1), nr.Mesh.icosphere(2, radius=0.7)]
    camera = nr.Camera.look_at(((0.0, 0.0, -3.0), (1.0, 1.0, -2.0)))
    together = nr.VisibleSurface.of(nr.fragments(meshes, camera, 16), meshes, camera)
    for number, mesh in enumerate(meshes):
        alone = nr.VisibleSurface.of(nr.fragments(mesh, camera[number], 16), mesh, camera[number])
        for name in ("points", "normals", "sides"):
            torch.testing.assert_close(getattr(together, name)[number], getattr(alone, name)[0])


def test_normals_of_corners_take_the_place_of_smooth_ones():
    """A cube with normals of its faces is as flat as with vertices of its own."""
    vertices, faces = nr.cube()
    corners = vertices[faces.long()]
    own = normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=-1)
    mesh = nr.UVMesh(vertices, faces, torch.zeros(12, 3, 2), torch.ones(1, 1, 3), normals=own[:, None].expand(12, 3, 3))
    camera = nr.Camera.look_at(EYE, viewing_angle=30)
    fragments = nr.fragments(mesh, camera, 32)
    surface = nr.VisibleSurface.of(fragments, mesh, camera)
    side = own[fragments.face_index.long()]
    torch.testing.assert_close(surface.normals[fragments.mask], side[fragments.mask], rtol=0, atol=1e-6)


def test_gradients_reach_vertices_and_camera():
    """A larger scene seen from farther away has larger points, and the same normals and views (Euler's theorem)."""
    vertices, faces = nr.icosphere(1)
    vertices, eye = vertices.requires_grad_(), torch.tensor(EYE, requires_grad=True)
    camera = nr.Camera.look_at(eye)
    surface = nr.VisibleSurface.of(nr.fragments((vertices, faces), camera, 16), (vertices, faces), camera)
    for value, degree in ((surface.points, 1), (surface.normals, 0), (surface.views, 0)):
        loss = (value * torch.rand_like(value)).sum()
        grads = torch.autograd.grad(loss, (vertices, eye), retain_graph=True)
        parts = [float((grad.double() * at.double()).sum()) for grad, at in zip(grads, (vertices, eye), strict=True)]
        size = sum(float((grad * at).abs().sum()) for grad, at in zip(grads, (vertices, eye), strict=True))
        assert all(grad.any() for grad in grads)
        assert abs(sum(parts) - degree * float(loss)) < 1e-5 * size
