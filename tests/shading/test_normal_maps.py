"""Normal maps, held to MikkTSpace's own code and to geometry."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from torch.nn.functional import normalize

import neural_renderer as nr
from neural_renderer.shading.pixels import material_maps

# Tangents of the corners of `octahedron`, from mikktspace.c (https://github.com/mmikk/MikkTSpace, genTangSpaceDefault).
MIKKTSPACE = [
    (-0.04863, -0.26336, -0.96347, 1),
    (0.99499, -0.03987, 0.09164, 1),
    (0.99857, 0.02424, 0.04771, 1),
    (0.99499, -0.03987, 0.09164, 1),
    (0.05617, 0.13880, 0.98873, 1),
    (0.99857, 0.02424, 0.04771, 1),
    (0.05617, 0.13880, 0.98873, 1),
    (0.70356, 0.08067, 0.70605, 1),
    (0.99857, 0.02424, 0.04771, 1),
    (0.74199, -0.15217, -0.65291, 1),
    (-0.04843, -0.26649, -0.96262, 1),
    (0.98189, -0.18368, 0.04645, 1),
    (0.99781, -0.04781, 0.04577, -1),
    (0.05642, 0.13423, 0.98934, -1),
    (0.99715, 0.05848, 0.04772, -1),
    (-0.04768, -0.27788, -0.95943, -1),
    (0.99781, -0.04781, 0.04577, -1),
    (0.99715, 0.05848, 0.04772, -1),
    (-0.71326, -0.07850, -0.69648, 1),
    (-0.07173, 0.87976, -0.46997, 1),
    (-0.30893, 0.95100, -0.01258, 1),
    (0.05642, 0.13423, 0.98934, -1),
    (0.78208, 0.06171, 0.62011, -1),
    (0.99715, 0.05848, 0.04772, -1),
]


def octahedron():
    """An octahedron with a seam, a mirrored face and two orientations of uv: vertices, faces, uv."""
    vertices = torch.tensor(
        [[1.1, 0, 0.1], [0, 0.9, 0], [-1.0, 0.1, 0], [0.1, -1.2, 0], [0.1, 0.2, 1.0], [0, -0.1, -0.8]]
    )
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]]
    faces = torch.tensor(faces)
    uv = torch.stack((vertices[:, 0] + 0.3 * vertices[:, 1], vertices[:, 1] - 0.2 * vertices[:, 2]), -1)[faces]
    uv[3] = uv[3] * 0.5 + 0.25
    uv[6] = uv[6].flip(-1)
    return vertices, faces, uv


def test_tangents_are_those_of_mikktspace():
    found = nr.corner_tangents(*octahedron())
    wanted = torch.tensor(MIKKTSPACE).view(8, 3, 4)
    torch.testing.assert_close(found, wanted, rtol=0, atol=2e-5)  # 5 digits


def test_files_that_split_vertices_have_the_same_tangents():
    vertices, faces, uv = octahedron()
    normals = nr.vertex_normals(vertices, faces)[0][faces]
    soup = nr.corner_tangents(vertices[faces].reshape(-1, 3), torch.arange(24).view(8, 3), uv, normals)
    torch.testing.assert_close(soup, nr.corner_tangents(vertices, faces, uv, normals))


def test_tangents_have_gradients_and_degenerate_uv_are_finite():
    vertices, faces, uv = octahedron()
    vertices, uv = vertices.requires_grad_(), uv.clone()
    uv[2] = 0.5
    uv.requires_grad_()
    tangents = nr.corner_tangents(vertices, faces, uv)
    (tangents[..., :3] * torch.rand(8, 3, 3)).sum().backward()
    torch.testing.assert_close(tangents[..., :3].norm(dim=-1), torch.ones(8, 3))
    for leaf in (vertices, uv):
        assert leaf.grad.isfinite().all() and leaf.grad.abs().sum() > 0


@pytest.mark.parametrize("face", [[0, 6, 0], [0, 6, 1], [0, 7, 4]])
def test_faces_without_an_area_leave_gradients_finite(face):
    """A vertex used twice, two in one place, three on a line: of no other face, or beside others."""
    vertices, faces, uv = octahedron()
    vertices = torch.cat((vertices, vertices[:1], vertices[[0, 4]].mean(0, keepdim=True))).requires_grad_()
    faces, uv = torch.cat((faces, torch.tensor([face]))), torch.cat((uv, torch.rand(1, 3, 2))).requires_grad_()
    tangents = nr.corner_tangents(vertices, faces, uv)
    assert tangents.isfinite().all()
    (tangents * torch.rand(9, 3, 4)).sum().backward()
    assert vertices.grad.isfinite().all() and uv.grad.isfinite().all()


def square(tilt, mirrored=False, image=(1.0, 1.0, 1.0)):
    """A white square in the plane z = 0 that faces −z, with a map that leans everywhere by (x, y) = ``tilt``.

    Seen from −z, +x is on the left: u runs from right to left in the world, from left to right in the picture.
    """
    vertices = torch.tensor([[1.0, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])
    uv = torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    uv = torch.stack((1 - uv[:, 0], uv[:, 1]), -1) if mirrored else uv
    lean = normalize(torch.tensor([*tilt, 1.0]), dim=0)
    texture = nr.Texture((0.5 + 0.5 * lean).expand(4, 4, 3))
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    mesh = nr.UVMesh(vertices, faces, uv, torch.tensor(image).expand(2, 2, 3))
    return dataclasses.replace(mesh, materials=(nr.Material(normal_texture=texture),))


def lit(mesh, direction):
    camera = nr.Camera.look_at((0.0, 0.0, -4.0), viewing_angle=20)
    return nr.render(mesh, camera, 8, light=nr.Light(0.0, 1.0, direction=direction), shading="smooth").rgb[0, 0, 4, 4]


@pytest.mark.parametrize("mirrored", [False, True])
def test_red_leans_to_larger_u_and_green_up(mirrored):
    """A map that leans by 45° is lit as a surface that leans so; u grows to the right, or to the left if mirrored."""
    right = -1.0 if not mirrored else 1.0  # x of larger u
    half, full = 0.5**0.5, torch.tensor(1.0)
    to_u, to_v = square((1.0, 0.0), mirrored), square((0.0, 1.0), mirrored)
    torch.testing.assert_close(lit(to_u, (right * half, 0.0, -half)), full)
    torch.testing.assert_close(lit(to_u, (-right * half, 0.0, -half)), torch.tensor(0.0), rtol=0, atol=1e-6)
    torch.testing.assert_close(lit(to_v, (0.0, half, -half)), full)
    torch.testing.assert_close(lit(to_v, (0.0, -half, -half)), torch.tensor(0.0), rtol=0, atol=1e-6)


def test_the_back_is_bumped_the_other_way():
    """From behind, the whole normal is reversed, as glTF asks."""
    camera = nr.Camera.look_at((0.0, 0.0, 4.0), viewing_angle=20)
    half = 0.5**0.5
    light = nr.Light(0.0, 1.0, direction=(half, 0.0, half))  # opposite of (−1, 0, −1)
    seen = nr.render(square((1.0, 0.0)), camera, 8, light=light, shading="smooth").rgb[0, 0, 4, 4]
    torch.testing.assert_close(seen, torch.tensor(1.0))


def test_a_flat_map_changes_nothing_and_scale_flattens():
    bumpy = square((0.7, -0.4))
    flat = dataclasses.replace(bumpy, materials=())
    direction = (-0.3, 0.5, -0.8)
    plain = lit(flat, direction)
    torch.testing.assert_close(lit(square((0.0, 0.0)), direction), plain)
    level = (dataclasses.replace(bumpy.materials[0], normal_scale=torch.tensor(0.0)),)
    torch.testing.assert_close(lit(dataclasses.replace(bumpy, materials=level), direction), plain)
    assert abs(float(lit(bumpy, direction) - plain)) > 0.05


def test_given_tangents_take_the_place_of_computed_ones():
    mesh = square((1.0, 0.0))
    turned = torch.tensor([0.0, 1.0, 0.0, 1.0]).expand(2, 3, 4)  # u points up
    torch.testing.assert_close(
        lit(dataclasses.replace(mesh, tangents=turned), (0.0, 0.5**0.5, -(0.5**0.5))), torch.tensor(1.0)
    )


def test_gradients_reach_the_map():
    mesh = square((0.2, 0.1))
    image = mesh.materials[0].normal_texture.image.clone().requires_grad_()
    scale = torch.tensor(1.0, requires_grad=True)
    material = nr.Material(normal_texture=nr.Texture(image), normal_scale=scale)
    lit(dataclasses.replace(mesh, materials=(material,)), (-0.3, 0.5, -0.8)).backward()
    texel, factor = image.detach()[0, 0].double().requires_grad_(), torch.tensor(1.0).double().requires_grad_()
    x, y, z = 2 * texel - 1
    normal = normalize(torch.stack((-factor * x, factor * y, -z)), dim=0)  # u grows towards −x, the face looks to −z
    normal.dot(torch.tensor([-0.3, 0.5, -0.8]).double()).backward()
    torch.testing.assert_close(image.grad.sum((0, 1)).double(), texel.grad, rtol=0, atol=1e-5)
    torch.testing.assert_close(scale.grad.double(), factor.grad, rtol=0, atol=1e-5)


def test_tangents_are_computed_once_until_the_mesh_changes(monkeypatch):
    calls = []

    def counted(*arguments):
        calls.append(arguments)
        return nr.corner_tangents(*arguments)

    monkeypatch.setattr(material_maps, "corner_tangents", counted)
    mesh = square((0.7, -0.4))
    first = lit(mesh, (-0.3, 0.5, -0.8))
    with torch.inference_mode():
        assert torch.equal(lit(mesh, (-0.3, 0.5, -0.8)), first)
    assert len(calls) == 1
    mesh.uv.copy_(mesh.uv.roll(1, 1))
    turned = lit(mesh, (-0.3, 0.5, -0.8))
    assert len(calls) == 2 and turned != first
    moving = dataclasses.replace(mesh, vertices=mesh.vertices.clone().requires_grad_())
    for number in (3, 4):  # gradients reach vertices through tangents, in each call
        lit(moving, (-0.3, 0.5, -0.8)).backward()
        assert len(calls) == number and moving.vertices.grad.abs().sum() > 0
    with torch.no_grad():
        assert lit(moving, (-0.3, 0.5, -0.8)) == lit(moving, (-0.3, 0.5, -0.8)) == turned
    assert len(calls) == 5
    lit(moving, (-0.3, 0.5, -0.8)).backward()  # what was kept has no gradients
    assert len(calls) == 6


def test_tangents_computed_in_inference_mode_serve_gradients():
    mesh, direction = square((0.7, -0.4)), (-0.3, 0.5, -0.8)
    with torch.inference_mode():
        lit(mesh, direction)
    image = mesh.materials[0].normal_texture.image.clone().requires_grad_()
    material = dataclasses.replace(mesh.materials[0], normal_texture=nr.Texture(image))
    object.__setattr__(mesh, "materials", (material,))  # the same mesh, with what it keeps
    lit(mesh, direction).backward()
    fresh = square((0.7, -0.4))
    again = image.detach().clone().requires_grad_()
    material = dataclasses.replace(fresh.materials[0], normal_texture=nr.Texture(again))
    lit(dataclasses.replace(fresh, materials=(material,)), direction).backward()
    assert torch.equal(image.grad, again.grad) and image.grad.abs().sum() > 0
