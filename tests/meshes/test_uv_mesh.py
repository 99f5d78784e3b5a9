"""Meshes with images as their colour, loaded without baking."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.io import save_image
from tests.rounding import EPS, rounding

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
    fragments = seen_from_the_front(mesh, 16)
    shown = mesh.shade(fragments)[0]
    below = fragments.face_index[0] == 0
    # A place among 16 texels is a few roundings of 16 off.
    torch.testing.assert_close(shown[below], picture.permute(1, 2, 0)[below], **rounding(10, 16))
    torch.testing.assert_close(shown[~below], torch.tensor([1.0, 0.25, 0.0]).expand(int((~below).sum()), 3))


def test_an_image_is_found_again_by_its_gradient(board):
    path, picture = board
    mesh = nr.UVMesh.load(path)
    fragments = seen_from_the_front(mesh, 16)
    target = mesh.shade(fragments)
    image = torch.full_like(mesh.images[0], 0.5).requires_grad_()
    optimizer = torch.optim.Adam([image], lr=0.1)
    for _ in range(100):
        loss = (dataclasses.replace(mesh, images=(image,)).shade(fragments) - target).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    below = fragments.face_index[0] == 0
    assert (image.detach()[below] - picture.permute(1, 2, 0)[below]).abs().max() < 0.02


def test_a_glb_file_shows_what_its_obj_file_shows(board, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path, _ = board
    trimesh.load(path, process=False).export(tmp_path / "board.glb")
    images = []
    for mesh in (nr.UVMesh.load(path), nr.UVMesh.load(tmp_path / "board.glb")):
        fragments = seen_from_the_front(mesh, 32)
        images.append(fragments.composite(mesh.shade(fragments)))
    apart = (images[0] - images[1]).abs().amax(1)[0]
    shows_image = (images[0][0] - torch.tensor([1.0, 0.25, 0.0])[:, None, None]).abs().amax(0) > 0.01
    assert 450 < shows_image.sum() < 550  # half of all pixels; trimesh writes the red as if it were linear
    assert (apart[shows_image] > 0.01).float().mean() < 0.07  # the diagonal


def test_the_vertices_of_a_file_without_colour_are_grey(tmp_path):
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = nr.UVMesh.load(tmp_path / "plain.obj")
    fragments = seen_from_the_front(mesh, 8)
    assert (mesh.shade(fragments)[fragments.mask] == 0.5).all() and mesh.to("cpu").images == ()


def test_what_does_not_fit(tmp_path):
    with pytest.raises(FileNotFoundError):
        nr.UVMesh.load(tmp_path / "none.obj")
    with pytest.raises(ValueError, match="fragments: expected"):
        mesh = nr.Mesh.icosphere(1)
        (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        nr.UVMesh.load(tmp_path / "plain.obj").shade(nr.fragments(mesh, nr.Camera.look_at((0.0, 0.0, 3.0)), 8))


def globe(color, device="cpu"):
    """A sphere whose corners all look at one image of one colour, and the same with cubes."""
    vertices, faces = nr.icosphere(2)
    count, color = len(faces), torch.tensor(color)
    generator = torch.Generator().manual_seed(1)
    painted = nr.UVMesh(
        vertices,
        faces,
        uv=torch.rand(count, 3, 2, generator=generator),
        image_index=torch.zeros(count, dtype=torch.int64),
        images=(color.expand(8, 8, 3).contiguous(),),
        colors=torch.zeros(count, 3, 3),
        wraps=("repeat",),
    )
    cubes = nr.Mesh(vertices, faces, color.expand(count, 2, 2, 2, 3))
    return painted.to(device), cubes.to(device)


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_render_draws_images_as_it_draws_cubes(device, gradient):
    """Outlines, light, background, gradients: all that is not the texture itself is the same."""
    eye = nr.get_points_from_angles(2.7, 20.0, torch.tensor([10.0, 130.0, 250.0])).to(device)
    target = torch.rand(3, 3, 24, 32, generator=torch.Generator().manual_seed(2)).to(device)
    found = []
    for mesh in globe((0.8, 0.4, 0.2), device):
        vertices = mesh.vertices.detach().clone().requires_grad_()
        way = torch.tensor([0.3, 0.8, 0.5], device=device, requires_grad=True)
        textures = None
        if isinstance(mesh, nr.UVMesh):
            drawn = dataclasses.replace(mesh, vertices=vertices)
        else:
            textures = mesh.textures.detach().clone().requires_grad_()
            drawn = (vertices, mesh.faces, textures)
        light = [nr.Light(0.4, 0.5, direction=way), nr.Light(0.0, 0.2)]
        images = nr.render(
            drawn, nr.Camera.look_at(eye, viewing_angle=30), (24, 32), light=light, background=(0.1, 0.2, 0.3),
            gradient=gradient,
        )  # fmt: skip
        ((images.rgb - target).square().sum() + images.alpha.sum() + images.depth.sum()).backward()
        found.append((*images, vertices.grad, way.grad))
    for one, other in zip(*found, strict=True):
        # Colours that are blended in other ways, and sums over 24 x 32 x 4 samples of what they pull.
        torch.testing.assert_close(one, other, rtol=0, atol=24 * 32 * 4 * EPS * float(other.detach().abs().max()))


def test_render_reaches_images_and_colours(board):
    mesh = nr.UVMesh.load(board[0])
    image, colors = mesh.images[0].clone().requires_grad_(), mesh.colors.clone().requires_grad_()
    mesh = dataclasses.replace(mesh, images=(image,), colors=colors)
    camera = nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True)
    rgb = nr.render(mesh, camera, 16, light=None, anti_aliasing=False).rgb
    fragments = seen_from_the_front(mesh, 16)
    assert torch.equal(rgb, fragments.composite(mesh.shade(fragments)))
    rgb.sum().backward()
    # Sums of shares of 1 over 16 x 16 pixels.
    assert image.grad.sum() == pytest.approx(3 * int((fragments.face_index == 0).sum()), rel=16**2 * 4 * EPS)
    assert colors.grad[1].sum() == pytest.approx(3 * int((fragments.face_index == 1).sum()), rel=16**2 * 4 * EPS)
    with pytest.raises(ValueError, match="background: expected"):
        nr.render(mesh, camera, 16, background=(1.0, 1.0))


@pytest.mark.parametrize("name", ["again.obj", "again.glb"])
def test_a_saved_mesh_is_the_same_again(board, tmp_path, name):
    if name.endswith("glb"):
        pytest.importorskip("trimesh")
    mesh = nr.UVMesh.load(board[0])
    mesh.save(tmp_path / "new" / name)
    again = nr.UVMesh.load(tmp_path / "new" / name)
    assert len(again.images) == 1 and (again.image_index < 0).sum() == 1
    assert sum(torch.equal(image, mesh.images[0]) for image in again.images) == 1
    camera = nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True)
    one, other = (nr.render(each, camera, 64, light=None, anti_aliasing=False) for each in (mesh, again))
    apart = (one.rgb - other.rgb).abs().amax(1) > 0.002  # colours are in steps of 1 / 255
    assert apart.sum() <= 64  # the diagonal, where the face of lower index is visible: files may change their order
    assert torch.equal(one.alpha, other.alpha)


def test_a_corner_keeps_several_places_on_an_image(tmp_path):
    """As at a seam: an OBJ file's corners refer to them, a GLB file repeats the vertex, and numbers it."""
    pytest.importorskip("trimesh")
    mesh, _ = globe((0.5, 0.5, 0.5))
    mesh = dataclasses.replace(mesh, images=(torch.rand(16, 16, 3).mul(255).round() / 255,))
    mesh.save(tmp_path / "ball.obj")
    again = nr.UVMesh.load(tmp_path / "ball.obj")
    assert torch.equal(again.vertices, mesh.vertices) and torch.equal(again.faces, mesh.faces)
    torch.testing.assert_close(again.uv, mesh.uv, **rounding(2))
    mesh.save(tmp_path / "ball.glb")
    corners = nr.UVMesh.load(tmp_path / "ball.glb")
    assert torch.equal(corners.vertices, mesh.vertices) and torch.equal(corners.faces, mesh.faces)
    torch.testing.assert_close(corners.uv, mesh.uv, **rounding(4))  # v is 1 - v in the file


def test_resized_images_lie_where_they_lay(board):
    path, picture = board
    mesh = nr.UVMesh.load(path).resized(4)
    below = mesh.images[0][2, 2]  # well inside of its face
    torch.testing.assert_close(below, picture[:, 7:13, 7:13].mean((1, 2)), rtol=0, atol=0.2)
    assert mesh.images[0].shape == (4, 4, 3) and torch.equal(mesh.resized(9).uv, mesh.uv)


def test_what_can_be_neither_saved_nor_drawn(board, tmp_path):
    mesh = nr.UVMesh.load(board[0])
    wrong = {
        "path: expected a name that ends in .obj, .glb": ("mesh.ply", {}),
        "image_index: expected one of 1 images or -1, got 1": ("mesh.obj", {"image_index": torch.tensor([0, 1])}),
        "image_index: expected one of 1 images or -1, got -3": ("mesh.obj", {"image_index": torch.tensor([-3, 0])}),
        "image_index: expected shape": ("mesh.obj", {"image_index": torch.tensor([0])}),
        "uv: expected shape": ("mesh.obj", {"uv": mesh.uv[:1]}),
        "uv: expected finite": ("mesh.obj", {"uv": torch.full_like(mesh.uv, torch.inf)}),
        "images: expected finite": ("mesh.obj", {"images": (torch.full((2, 2, 3), torch.nan),)}),
        "images: expected shape": ("mesh.obj", {"images": (torch.zeros(2, 2, 4),)}),
        "images: expected at least one pixel": ("mesh.obj", {"images": (torch.zeros(0, 2, 3),)}),
        "wraps: expected 1 like images, got 0": ("mesh.obj", {"wraps": ()}),
        "wrap: expected one of repeat, clamp": ("mesh.obj", {"wraps": ("border",)}),
    }
    camera = nr.Camera.look_at((0.0, 0.0, 3.0))
    for sentence, (name, change) in wrong.items():
        bad = dataclasses.replace(mesh, **change)
        with pytest.raises(ValueError, match=sentence):
            bad.save(tmp_path / name)
        if change:
            with pytest.raises(ValueError, match=sentence):
                nr.render(bad, camera, 8)
    for change in ({"images": mesh.images[0][None]}, {"images": None}, {"wraps": "repeat"}):
        with pytest.raises(TypeError, match=f"{next(iter(change))}: expected a tuple, got"):
            nr.render(dataclasses.replace(mesh, **change), camera, 8)
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(OSError, match=r"folder\.obj"):
        mesh.save(tmp_path / "folder.obj")
    assert not (tmp_path / "folder.mtl").exists() and not list(tmp_path.glob("folder_*"))


def test_one_image_in_three_forms_of_coordinates():
    vertices, faces = nr.icosphere(1)
    image = torch.rand(8, 8, 3, requires_grad=True)
    uv = torch.rand(len(vertices), 2)
    corners = uv[faces.long()]
    full = nr.UVMesh(
        vertices, faces, corners, torch.zeros(80, dtype=torch.int64), (image,), torch.ones(80, 3, 3), ("clamp",)
    )
    camera = nr.Camera.look_at((0.0, 0.0, -2.5))
    expected = nr.render(full, camera, 16).rgb
    pair = (corners.reshape(-1, 2), torch.arange(240).reshape(80, 3))
    for form in (uv, corners, pair, uv.numpy()):
        mesh = nr.UVMesh(vertices, faces, form, image, wrap="clamp")
        assert torch.equal(nr.render(mesh, camera, 16).rgb, expected)
    named = nr.UVMesh(vertices.numpy(), faces.long().numpy(), uv, image=image)
    assert named.wraps == ("repeat",) and named.images[0] is image and named.faces.dtype == torch.int32
    assert dataclasses.replace(named, wraps=("clamp",)).uv is named.uv
    nr.render(named, camera, 16).rgb.sum().backward()
    assert image.grad.any()
    part = named.submesh([3, 4])
    assert torch.equal(part.vertices[part.faces.long()], vertices[faces[[3, 4]].long()])
    assert torch.equal(part.uv, corners[[3, 4]]) and part.image_index.tolist() == [0, 0]
    soup = nr.UVMesh(vertices[faces.long()].reshape(-1, 3), pair[1], corners, image)
    merged = soup.merge_vertices()
    assert len(merged.vertices) == 42 and torch.equal(merged.uv, corners)
    assert torch.equal(merged.vertices[merged.faces.long()], vertices[faces.long()])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"image": torch.rand(3, 8, 9)}, r"image: expected \[H, W, 3\], got .* channels first"),
        ({"image": torch.rand(8, 8, 4)}, r"image: expected \[H, W, 3\], got .* is without transparency"),
        ({"image": torch.rand(8, 8)}, r"image: expected shape \[H, W, 3\]"),
        ({"uv": torch.rand(7, 2)}, r"uv: expected shape \[8, 2\]"),
        ({"uv": torch.rand(7, 3, 2)}, r"uv: expected shape \[12, 3, 2\]"),
        ({"uv": (torch.rand(7, 2), torch.full((12, 3), 7))}, r"uv: expected indices in \[0, 7\)"),
        ({"faces": torch.full((12, 3), 8)}, "faces: expected indices"),
        ({"wrap": "border"}, "wrap: expected"),
        ({"image_index": torch.zeros(12, dtype=torch.int64)}, "image: expected only one of image and image_index"),
    ],
)
def test_what_does_not_fit_one_image(change, sentence):
    vertices, faces = nr.cube()
    given = {"vertices": vertices, "faces": faces, "uv": torch.rand(8, 2), "image": torch.rand(8, 8, 3)}
    with pytest.raises(ValueError, match=sentence):
        nr.UVMesh(**(given | change))


@pytest.mark.parametrize("image", [torch.zeros(8, 9, 3, dtype=torch.uint8), np.zeros((8, 9, 3), np.uint8)])
def test_images_of_bytes_are_refused(image):
    with pytest.raises(TypeError, match=r"image: expected a floating.*got \[8, 9, 3\] uint8; image / 255"):
        nr.UVMesh(*nr.cube(), torch.rand(8, 2), image)


def test_parameters_are_tensors_of_its_own() -> None:
    image = torch.rand(4, 4, 3)
    mesh = nr.UVMesh(*nr.cube(), torch.rand(8, 2), image)
    assert list(mesh.parameters()) == [] and mesh.num_faces == 12 and mesh.num_vertices == 8
    leaf = mesh.trainable()
    assert [part.shape for part in leaf.parameters()] == [(8, 3), (4, 4, 3)]
    assert not image.requires_grad and not mesh.vertices.requires_grad and leaf.uv is mesh.uv
    rough = torch.tensor(0.5, requires_grad=True)
    shiny = nr.UVMesh(*nr.cube(), torch.rand(8, 2), image, materials=(nr.Material(roughness=rough),))
    assert next(shiny.parameters()) is rough
    assert [part.shape for part in mesh.trainable("uv", "colors").parameters()] == [(12, 3, 2), (12, 3, 3)]
    for wrong in ("faces", "normals", "hue"):
        with pytest.raises(ValueError, match=f"names: expected some of vertices, uv, images, colors, got '{wrong}'"):
            mesh.trainable(wrong)


def test_one_line_describes_it() -> None:
    mesh = nr.UVMesh(*nr.cube(), torch.rand(8, 2), torch.rand(4, 6, 3))
    assert repr(mesh) == "UVMesh(8 vertices, 12 faces, 1 image of 4 × 6, cpu)"
    assert repr(nr.batch([mesh, mesh])) == "UVMesh(batch of 2, 8 vertices, 12 faces, 1 image of 4 × 6, cpu)"


def test_materials_are_a_tuple():
    vertices, faces = nr.icosphere(1)
    arguments = vertices, faces, vertices[:, :2], torch.ones(1, 1, 3)
    with pytest.raises(TypeError, match="materials: expected a tuple of Material, got Material"):
        nr.UVMesh(*arguments, materials=nr.Material())
    assert "1 material, cpu" in repr(nr.UVMesh(*arguments, materials=(nr.Material(),)))
