"""Subdivision: midpoint and Loop, as trimesh computes them, with what belongs to the faces."""

from __future__ import annotations

import dataclasses

import pytest
import torch
import trimesh
from torch.autograd import gradcheck

import neural_renderer as nr
from neural_renderer.meshes.subdivision import split_faces, subdivided
from tests.rounding import rounding


def tube(sides: int = 7, rings: int = 4) -> tuple[torch.Tensor, torch.Tensor]:
    """A tube with two open ends and uneven vertices."""
    i, j = torch.meshgrid(torch.arange(rings), torch.arange(sides), indexing="ij")
    angle = 2 * torch.pi * j / sides
    vertices = torch.stack((angle.cos() * (1 + 0.3 * i), angle.sin(), i + 0.2 * (3 * angle).sin()), -1)
    place = (i * sides + j)[:-1].flatten()
    following = (i * sides + (j + 1) % sides)[:-1].flatten()
    upper, upper_following = place + sides, following + sides
    faces = torch.cat(
        (torch.stack((place, following, upper_following), 1), torch.stack((place, upper_following, upper), 1))
    )
    return vertices.reshape(-1, 3).double(), faces


SHAPES = {
    "closed": tuple(part.double() if part.is_floating_point() else part for part in nr.cube()),
    "open": tube(),
    "torus": tuple(part.double() if part.is_floating_point() else part for part in nr.torus(segments=9, sides=5)),
}


def test_four_faces_of_a_quarter_each() -> None:
    vertices, faces = (part.double() for part in nr.cube())
    edges, split = split_faces(faces.long(), len(vertices))
    assert len(edges) == 18 and (edges[:, 0] < edges[:, 1]).all()
    assert torch.equal(edges, edges[torch.argsort(edges[:, 0] * 8 + edges[:, 1])])
    a, b, c = torch.cat((vertices, vertices[edges].mean(1)))[split].unbind(1)
    # Corners of the cube are -1 and 1: all products are exact.
    areas = torch.linalg.cross(b - a, c - a)
    p, q, r = vertices[faces.long()].unbind(1)
    assert torch.equal(areas, (torch.linalg.cross(q - p, r - p) / 4).repeat_interleave(4, 0))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scheme", ["midpoint", "loop"])
def test_triangles_are_those_of_trimesh(shape: str, scheme: str) -> None:
    vertices, faces = SHAPES[shape]
    given = (vertices.numpy(), faces.numpy())
    loop = trimesh.remesh.subdivide_loop
    theirs = loop(*given, iterations=1) if scheme == "loop" else trimesh.remesh.subdivide(*given)
    expected = torch.as_tensor(theirs[0])[torch.as_tensor(theirs[1])]
    found, split = subdivided(vertices, faces, scheme)

    def order(triangles: torch.Tensor) -> torch.Tensor:
        """Sort triangles by their centres."""
        centres = triangles.mean(1) @ torch.tensor([1.0, 7.3, 31.7], dtype=torch.float64)
        return triangles[centres.argsort()]

    # Each has its own order of corners; the centres and the areas do not depend on it.
    own, other = order(found[split.long()]), order(expected)
    torch.testing.assert_close(own.mean(1), other.mean(1), rtol=0, atol=1e-12)
    areas = [torch.linalg.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (own, other)]
    torch.testing.assert_close(*areas, rtol=0, atol=1e-12)
    assert split.dtype == faces.dtype


def test_loop_keeps_corners_where_several_creases_meet() -> None:
    """Two triangles that touch in one vertex, and three at one edge: neither inside nor on one boundary."""
    vertices = torch.rand(6, 3, dtype=torch.float64)
    bow, _ = subdivided(vertices[:5], torch.tensor([[0, 1, 2], [0, 3, 4]]), "loop")
    assert torch.equal(bow[0], vertices[0])
    fan, split = subdivided(vertices[:5], torch.tensor([[0, 1, 2], [1, 0, 3], [0, 1, 4]]), "loop")
    middle = (vertices[0] + vertices[1]) / 2
    assert (fan == middle).all(1).any() and torch.equal(fan[0], vertices[0]) and len(split) == 12
    alone, _ = subdivided(vertices, torch.tensor([[0, 1, 2]]), "loop")
    assert torch.equal(alone[3:6], vertices[3:])  # vertices without a face


def test_loop_has_gradients() -> None:
    vertices, faces = tube(4, 3)
    leaf = vertices.requires_grad_()
    assert gradcheck(lambda v: subdivided(v, faces, "loop")[0], (leaf,))


@pytest.mark.parametrize("size", [1, 2, 4])
def test_textures_stay_where_they_are(size: int) -> None:
    """The picture of a mesh does not change; texel by texel if their cubes hold linear functions."""
    vertices, faces = nr.cube()
    if size == 1:
        mesh = nr.Mesh(vertices, faces, torch.rand(len(faces), 1, 1, 1, 3))
    else:
        mesh = nr.Mesh(vertices, faces, vertex_colors=0.5 + 0.5 * vertices, texture_size=size)
    finer = mesh.subdivide(2)
    assert (finer.num_faces, finer.texture_size) == (16 * mesh.num_faces, size)
    camera = nr.Camera.look_at((1.0, 2.0, -4.0), viewing_angle=30)
    with torch.no_grad():
        before, after = (nr.render(one, camera, 64, light=None, anti_aliasing=False).rgb for one in (mesh, finer))
    # Cubes draw a linear function up to 3 % (T = 4) or 12 % (T = 2) of its range off, each level anew.
    assert (before - after).abs().max() < {1: 1e-6, 2: 0.25, 4: 0.08}[size]
    assert (before - after).abs().mean() < {1: 1e-6, 2: 0.03, 4: 0.01}[size]
    mesh = mesh.trainable()
    mesh.set_lr(0.5, 2.0)
    assert mesh.subdivide().vertices.lr == 0.5 and mesh.subdivide().vertices.requires_grad


def test_what_belongs_to_the_faces_of_a_uv_mesh() -> None:
    vertices, faces = nr.cube()
    image = torch.rand(16, 16, 3, requires_grad=True)
    uv = torch.rand(12, 3, 2)
    cube = nr.UVMesh(vertices, faces, uv, image)
    half = torch.where(torch.arange(12) % 2 == 0, 0, -1)
    normals = torch.nn.functional.normalize(torch.rand(12, 3, 3) - 0.5, dim=-1)
    tangents = torch.cat((normals.roll(1, -1), -torch.ones(12, 3, 1)), -1)
    cube = dataclasses.replace(
        cube, image_index=half, colors=torch.rand(12, 3, 3), normals=normals, tangents=tangents, uv1=uv.flip(-1)
    )
    finer = cube.subdivide(2)
    assert finer.num_faces == 16 * 12 and finer.images[0] is image
    assert torch.equal(finer.image_index, half.repeat_interleave(16))
    torch.testing.assert_close(finer.normals.norm(dim=-1), torch.ones(192, 3))
    torch.testing.assert_close(finer.uv1, finer.uv.flip(-1))
    assert (finer.tangents[..., 3] == -1).all()
    camera = nr.Camera.look_at((1.0, 2.0, -4.0), viewing_angle=30)
    before, after = (nr.render(one, camera, 48, anti_aliasing=False).rgb for one in (cube, finer))
    # Mipmap levels come from differences between pixels of one face, and the last pixel of a face has none.
    assert (before - after).abs().mean() < 0.02
    after.sum().backward()
    assert image.grad.any()
    smooth = cube.subdivide(1, "loop")
    assert smooth.normals is None and smooth.tangents is None and smooth.uv1 is not None
    torch.testing.assert_close(smooth.vertices, nr.Mesh(vertices, faces).subdivide(1, "loop").vertices.detach())
    radius = nr.Mesh(vertices, faces).subdivide(4, "loop").vertices.norm(dim=1)
    assert radius.max() / radius.min() < 1.35  # a cube's is √3
    torch.testing.assert_close(nr.Mesh(vertices, faces).subdivide(2).vertices[:8], vertices, **rounding(1, 1))


def test_errors() -> None:
    mesh = nr.Mesh.icosphere(1)
    with pytest.raises(ValueError, match="scheme: expected one of 'midpoint', 'loop', got 'butterfly'"):
        mesh.subdivide(1, "butterfly")
    with pytest.raises(ValueError, match="levels: expected"):
        mesh.subdivide(0)
    with pytest.raises(TypeError, match="levels: expected"):
        mesh.subdivide(1.5)
