"""Meshes with images as their colour, loaded without baking."""

from __future__ import annotations

import dataclasses

import pytest
import torch

import neural_renderer as nr
from neural_renderer.io import save_image

OBJ = """mtllib board.mtl
v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl board
f 1/1 2/2 3/3
usemtl red
f 1/1 3/3 4/4
"""
MTL = "newmtl board\nKd 1 1 1\nmap_Kd board.png\nnewmtl red\nKd 1 0.25 0\n"


@pytest.fixture
def board(tmp_path):
    picture = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0)).mul(255).round() / 255
    save_image(tmp_path / "board.png", picture)
    (tmp_path / "board.obj").write_text(OBJ)
    (tmp_path / "board.mtl").write_text(MTL)
    return tmp_path / "board.obj", picture


def seen_from_the_front(mesh, size, **options):
    camera = nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True)
    return nr.fragments(mesh, camera, size, anti_aliasing=False, **options)


def test_an_image_is_shown_texel_by_texel_and_a_colour_as_it_is(board):
    path, picture = board
    mesh = nr.UVMesh.load(path)
    assert mesh.image_index.tolist() == [0, -1] and len(mesh.images) == 1
    seen = seen_from_the_front(mesh, 16)
    shown = mesh.shade(seen)[0]
    below = seen.face_index[0] == 0
    torch.testing.assert_close(shown[below], picture.permute(1, 2, 0)[below], rtol=0, atol=1e-5)
    torch.testing.assert_close(shown[~below], torch.tensor([1.0, 0.25, 0.0]).expand(int((~below).sum()), 3))


def test_an_image_is_found_again_by_its_gradient(board):
    path, picture = board
    mesh = nr.UVMesh.load(path)
    seen = seen_from_the_front(mesh, 16)
    target = mesh.shade(seen)
    image = torch.full_like(mesh.images[0], 0.5).requires_grad_()
    optimizer = torch.optim.Adam([image], lr=0.1)
    for _ in range(100):
        loss = (dataclasses.replace(mesh, images=(image,)).shade(seen) - target).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    below = seen.face_index[0] == 0
    assert (image.detach()[below] - picture.permute(1, 2, 0)[below]).abs().max() < 0.02


def test_a_glb_file_shows_what_its_obj_file_shows(board, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path, _ = board
    trimesh.load(path, process=False).export(tmp_path / "board.glb")
    images = []
    for mesh in (nr.UVMesh.load(path), nr.UVMesh.load(tmp_path / "board.glb")):
        seen = seen_from_the_front(mesh, 32)
        images.append(seen.composite(mesh.shade(seen)))
    apart = (images[0] - images[1]).abs().amax(1)[0]
    shows_image = (images[0][0] - torch.tensor([1.0, 0.25, 0.0])[:, None, None]).abs().amax(0) > 0.01
    assert 450 < shows_image.sum() < 550  # half of all pixels; trimesh writes the red as if it were linear
    assert (apart[shows_image] > 0.01).float().mean() < 0.07  # the diagonal


def test_the_vertices_of_a_file_without_colour_are_grey(tmp_path):
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = nr.UVMesh.load(tmp_path / "plain.obj")
    seen = seen_from_the_front(mesh, 8)
    assert (mesh.shade(seen)[seen.mask] == 0.5).all() and mesh.to("cpu").images == ()


def test_gutters_take_the_colours_beside_them():
    texture = torch.zeros(32, 32, 3)
    texture[8:24, 8:16] = torch.tensor([1.0, 0, 0])
    texture[8:24, 16:24] = torch.tensor([0.0, 0, 1])
    quad = torch.tensor([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]])
    uv = quad[torch.tensor([[0, 1, 2], [0, 2, 3]])]
    texture.requires_grad_()
    filled = nr.fill_gutters(texture, uv)
    assert torch.equal(filled[8:24, 8:24], texture[8:24, 8:24])
    assert (filled.sum(-1) - 1).abs().max() < 1e-5  # nothing of the black
    assert filled[16, 2, 0] > 0.8 and filled[16, 29, 2] > 0.8
    filled.sum().backward()
    assert (texture.grad[:8] == 0).all() and (texture.grad[8:24, 8:24] >= 1).all()
    torch.testing.assert_close(nr.fill_gutters(texture.detach(), uv + 3), filled.detach())


def test_what_does_not_fit(tmp_path):
    with pytest.raises(ValueError, match="uv: expected shape"):
        nr.fill_gutters(torch.zeros(4, 4, 3), torch.zeros(2, 2))
    with pytest.raises(FileNotFoundError):
        nr.UVMesh.load(tmp_path / "none.obj")
    with pytest.raises(ValueError, match="triangles: expected"):
        mesh = nr.Mesh.icosphere(1)
        (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        nr.UVMesh.load(tmp_path / "plain.obj").shade(nr.fragments(mesh, nr.Camera.look_at((0.0, 0.0, 3.0)), 8))
