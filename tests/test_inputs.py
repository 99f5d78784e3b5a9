"""Objects of other libraries, arrays and lists, where meshes and images are expected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

import neural_renderer as nr
from tests.paths import EXAMPLES

CAMERA = nr.Camera.look_at((0.5, 0.8, -2.6))


def test_meshes_of_trimesh() -> None:
    ball = trimesh.creation.icosphere(2)
    ball.visual.vertex_colors = np.random.default_rng(0).integers(0, 256, (162, 4)).astype(np.uint8)
    mesh = nr.Mesh.from_trimesh(ball)
    want = nr.Mesh(ball.vertices.astype(np.float32), ball.faces, vertex_colors=ball.visual.vertex_colors[:, :3] / 255)
    assert torch.equal(mesh.vertices, want.vertices) and torch.equal(mesh.faces, want.faces)
    torch.testing.assert_close(mesh.textures, want.textures)
    back = mesh.to_trimesh()
    assert np.array_equal(back.vertices, ball.vertices.astype(np.float32)) and np.array_equal(back.faces, ball.faces)
    assert np.abs(back.visual.vertex_colors[:, :3].astype(int) - ball.visual.vertex_colors[:, :3]).max() <= 1
    drawn = nr.render(ball, CAMERA, 32).rgb
    assert torch.equal(drawn, nr.render(nr.UVMesh.from_trimesh(ball), CAMERA, 32).rgb) and drawn.std() > 0.1
    assert torch.equal(nr.render([ball, ball], CAMERA, 32).rgb[1], drawn[0])
    assert torch.equal(nr.fragments(ball, CAMERA, 32).face_index, nr.fragments(want, CAMERA, 32).face_index)
    scene = trimesh.Scene([ball])
    scene.add_geometry(trimesh.creation.box(), transform=trimesh.transformations.translation_matrix([2, 0, 0]))
    both = nr.Mesh.from_trimesh(scene, texture_size=1)
    assert (both.num_vertices, both.num_faces) == (170, 332) and both.vertices.max() == 2.5


@pytest.mark.parametrize("name", ["spot", "box"])
def test_images_go_to_trimesh_and_back(name: str) -> None:
    mesh = (
        nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
        if name == "spot"
        else nr.UVMesh.from_trimesh(trimesh.creation.box())
    )
    back = mesh.to_trimesh()
    assert np.array_equal(back.vertices[back.faces].astype(np.float32), mesh.vertices[mesh.faces.long()].numpy())
    assert torch.equal(nr.render(back, CAMERA, 64).rgb, nr.render(mesh, CAMERA, 64).rgb)


def test_textures_of_trimesh() -> None:
    loaded = trimesh.load(EXAMPLES / "data" / "spot.obj", process=False)
    found, want = nr.UVMesh.from_trimesh(loaded), nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    assert found.num_faces == want.num_faces and len(found.images) == 1
    mine, theirs = (nr.render(mesh, CAMERA, 64, light=None).rgb for mesh in (found, want))
    assert (mine - theirs).abs().mean() < 1e-3


@pytest.mark.parametrize("kind", [nr.Mesh, nr.UVMesh])
def test_other_meshes_are_named(kind: type) -> None:
    with pytest.raises(TypeError, match="mesh: expected a Trimesh or Scene of trimesh, got int"):
        kind.from_trimesh(3)
    with pytest.raises(ValueError, match="mesh: expected at least one face"):
        kind.from_trimesh(trimesh.Scene())
    with pytest.raises(TypeError, match=r"mesh: expected a Mesh, .* got int"):
        nr.render(3, CAMERA, 16)
    with pytest.raises(ValueError, match="finite"):
        kind.from_trimesh(trimesh.Trimesh([[0, 0, np.inf], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False))


def test_pictures_of_pillow(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (32, 32, 3)).astype(np.uint8)
    picture, image = Image.fromarray(pixels), torch.from_numpy(pixels.astype(np.float32) / np.float32(255))
    nr.save_image(tmp_path / "a.png", picture)
    assert torch.equal(nr.load_image(tmp_path / "a.png"), image)
    nr.save_image(tmp_path / "b.png", picture.convert("L"))
    mesh = nr.Mesh.icosphere(1)
    found, want = (nr.render(mesh, CAMERA, 32, background=one).rgb for one in (picture, image))
    assert torch.equal(found, want)
    uv = torch.rand(80, 3, 2)
    assert torch.equal(nr.UVMesh(mesh.vertices, mesh.faces, uv, picture).images[0], image)
    assert torch.equal(nr.Texture(picture).image, image)
    with pytest.raises(ValueError, match=r"image\[..., :3\] is without transparency"):
        nr.UVMesh(mesh.vertices, mesh.faces, uv, picture.convert("RGBA"))


def test_lists_and_bytes() -> None:
    vertices, faces = nr.cube()
    mesh = nr.Mesh(vertices.tolist(), faces.tolist(), vertex_colors=vertices.abs().tolist())
    assert torch.equal(mesh.textures, nr.Mesh(vertices, faces, vertex_colors=vertices.abs()).textures)
    colors = np.full((8, 3), 255, np.uint8)
    with pytest.raises(TypeError, match=r"vertex_colors: .* got \[8, 3\] uint8; vertex_colors / 255"):
        nr.Mesh(vertices, faces, vertex_colors=colors)
    with pytest.raises(TypeError, match=r"face_colors: .* uint8; face_colors / 255"):
        nr.Mesh(vertices, faces, face_colors=torch.ones(12, 3, dtype=torch.uint8))
    with pytest.raises(TypeError, match="vertices: expected a floating-point torch tensor, got list"):
        nr.Mesh([[0.0, 1.0], [2.0]], faces)
    assert nr.Mesh(vertices.numpy().astype(">f4"), faces.numpy()[::-1].astype(np.uint16)).num_faces == 12


def test_a_depth_needs_a_range(tmp_path: Path) -> None:
    images = nr.render(nr.Mesh.icosphere(2), CAMERA, 32)
    with pytest.raises(ValueError, match=r"image: expected numbers in \[0, 1\], got .* to 100, .* for a depth"):
        nr.save_image(tmp_path / "d.png", images.depth[0])
    nr.save_image(tmp_path / "d.png", (3.7 - images.depth[0]) / 2)
    assert len(nr.load_image(tmp_path / "d.png").unique()) > 20
    for light in (3 * images.rgb[0], images.alpha[0], torch.full((4, 4), 2.0), torch.zeros(4, 4)):
        nr.save_image(tmp_path / "c.png", light)  # clamped, as ever


@pytest.mark.parametrize("suffix", [".hdr", ".exr"])
def test_light_beyond_1(suffix: str, tmp_path: Path) -> None:
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    generator = torch.Generator().manual_seed(0)
    light = 10 ** (8 * torch.rand(8, 16, 1, generator=generator) - 4) * torch.rand(8, 16, 3, generator=generator)
    light[0, 0], light[0, 1], light[0, 2] = 0, torch.tensor([1.0, 0.999, 0.0]), 255.5
    for image in (light, light.movedim(2, 0), light.numpy()):
        nr.save_image(tmp_path / f"sky{suffix}", image)
        found = nr.EnvironmentLight.load(tmp_path / f"sky{suffix}").image
        # Radiance has eight bits for the largest channel of a pixel, the highest of which is 1.
        bound = light.amax(-1, keepdim=True) / 256 if suffix == ".hdr" else 0 * light
        assert ((found - light).abs() <= bound).all()
    nr.save_image(tmp_path / f"grey{suffix}", light[..., 0])
    grey = nr.EnvironmentLight.load(tmp_path / f"grey{suffix}").image
    assert torch.equal(grey[..., 0], grey[..., 2])
    with pytest.raises(ValueError, match="NaN"):
        nr.save_image(tmp_path / f"sky{suffix}", light * torch.nan)
