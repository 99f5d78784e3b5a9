"""Meshes in other formats: reading, refused files, and round trips."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from neural_renderer.io import load_mesh, save_mesh
from neural_renderer.io.cubes import bake_corners
from neural_renderer.meshes.primitives import cube, icosphere
from neural_renderer.meshes.uv_mesh import UVMesh
from tests.paths import TEAPOT

REFUSED = {
    "assimp_misc/OutOfMemory.off": "got '353535235358 6 0'",
    "assimp_misc/invalid.off": "expected a count and as many vertices in face 1, got '2'",
    "assimp_misc/issue623.ply": "expected at least 168 numbers after the header, got the end of the file after 144",
    "trimesh/empty.stl": "0 vertices but no faces",
}


def coloured_sphere(size: int = 4):
    vertices, faces = icosphere(1)
    return vertices, faces, bake_corners((vertices[faces.long()] + 1) / 2, size)


def test_every_nasty_file_loads_or_is_refused(nasty):
    paths = [p for p in sorted(nasty.rglob("*")) if p.suffix.lower() in (".ply", ".stl", ".off")]
    assert len(paths) >= 9
    for path in paths:
        name = path.relative_to(nasty).as_posix()
        if name in REFUSED:
            with pytest.raises(ValueError) as error:
                load_mesh(path)
            assert path.name in str(error.value) and REFUSED[name] in str(error.value), name
        else:
            vertices, faces, _ = load_mesh(path)
            assert torch.isfinite(vertices).all() and faces.max() < len(vertices) and len(faces)


def test_obj_without_colours_has_no_textures_and_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vertices, faces, textures = load_mesh(TEAPOT)
    assert vertices.shape == (1292, 3) and faces.shape == (2464, 3) and textures is None
    assert faces.dtype == torch.int32 and vertices.dtype == torch.float32


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb", ".GLB"])
@pytest.mark.parametrize("size", [2, 4])
def test_save_and_load(tmp_path, suffix, size):
    vertices, faces, textures = coloured_sphere(size)
    path = tmp_path / "folder" / f"sphere{suffix}"
    save_mesh(path, vertices.double().requires_grad_(), faces, textures)
    vertices2, faces2, textures2 = load_mesh(path, size)
    assert textures2 is not None and (textures - textures2).abs().max() < (0.03 if size == 2 else 0.01)
    assert torch.equal(vertices[faces.long()], vertices2[faces2.long()])
    if suffix.lower() != ".glb":
        assert torch.equal(vertices, vertices2) and torch.equal(faces, faces2)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_one_colour_a_face(tmp_path, suffix):
    """Two triangles apart, so that a vertex has the colour of its only face; files hold 255 levels."""
    vertices, faces = (
        torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [2, 1, 0]]),
        torch.arange(6),
    )
    textures = torch.tensor([[0.1, 0.5, 0.9], [0.8, 0.3, 0.2]]).view(2, 1, 1, 1, 3)
    save_mesh(tmp_path / f"two{suffix}", vertices, faces.view(2, 3), textures)
    found = load_mesh(tmp_path / f"two{suffix}", 1)[2]
    assert found is not None and found.shape == textures.shape and (found - textures).abs().max() < 0.5 / 255 + 1e-6


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_save_without_textures(tmp_path, suffix):
    vertices, faces = icosphere(1)
    save_mesh(tmp_path / f"m{suffix}", vertices, faces)
    vertices2, faces2, textures = load_mesh(tmp_path / f"m{suffix}")
    assert torch.equal(vertices, vertices2) and torch.equal(faces, faces2)
    assert textures is None or (textures == 1).all()


def test_glb_of_one_colour_shares_vertices(tmp_path):
    vertices, faces = icosphere(2)
    color = torch.tensor([0.72, 0.5, 0.3])
    save_mesh(tmp_path / "m.glb", vertices, faces, color.expand(len(faces), 2, 2, 2, 3))
    again, triangles, textures = load_mesh(tmp_path / "m.glb", 2)
    assert len(again) == len(vertices) and torch.equal(again[triangles.long()], vertices[faces.long()])
    assert textures is not None and (textures - color).abs().max() < 1e-3
    material = next(iter(trimesh.load(tmp_path / "m.glb").geometry.values())).visual.material
    assert (material.metallicFactor, material.roughnessFactor, material.doubleSided) == (0, 1, True)


def test_glb_material_is_matt_and_two_sided(tmp_path):
    save_mesh(tmp_path / "m.glb", *coloured_sphere())
    material = next(iter(trimesh.load(tmp_path / "m.glb").geometry.values())).visual.material
    assert (material.metallicFactor, material.roughnessFactor, material.doubleSided) == (0, 1, True)


def test_ply_colours_are_means_at_the_vertices(tmp_path):
    vertices, faces = cube()
    textures = torch.zeros(12, 2, 2, 2, 3)
    textures[:, :, :, :, 0] = torch.arange(12)[:, None, None, None] / 12
    save_mesh(tmp_path / "m.ply", vertices, faces, textures)
    saved = trimesh.load(tmp_path / "m.ply", process=False).visual.vertex_colors[:, 0] / 255
    around = [np.mean([f / 12 for f in range(12) if v in faces[f].tolist()]) for v in range(8)]
    assert np.abs(saved - around).max() < 0.003


def test_stl_has_equal_vertices_joined(tmp_path):
    vertices, faces = icosphere(1)
    trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False).export(tmp_path / "m.stl")
    vertices2, faces2, textures = load_mesh(tmp_path / "m.stl")
    assert vertices2.shape == vertices.shape and textures is None
    assert torch.allclose(vertices2[faces2.long()], vertices[faces.long()])
    assert faces2[0].tolist() == [0, 1, 2]


def test_scene_is_put_together_and_mirrored_parts_stay_outside_out(tmp_path):
    vertices, faces = (x.numpy() for x in cube())
    red = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 128, 0, 255]), uv=np.zeros((8, 2))
    )
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(vertices, faces, visual=red, process=False), node_name="a")
    mirror = np.diag([-1.0, 1, 1, 1])
    mirror[0, 3] = 10
    scene.add_geometry(trimesh.Trimesh(vertices, faces, process=False), node_name="b", transform=mirror)
    scene.export(tmp_path / "scene.glb")
    points, corners, textures = load_mesh(tmp_path / "scene.glb")
    assert len(points) == 16 and len(corners) == 24 and textures is not None
    for part in (corners[:12], corners[12:]):
        assert torch.linalg.det(points[part.long()] - points[part.long()].mean((0, 1))).sum() > 0
    assert {-1.0, 1.0, 9.0, 11.0} == set(points[:, 0].tolist())
    colors = {tuple(round(c, 2) for c in t[0, 0, 0].tolist()) for t in textures}
    assert (1.0, 0.74, 0.0) in colors  # linear 0.5 is 0.74 in sRGB
    assert len(colors) == 2


def test_texture_times_factor_and_upright(tmp_path):
    picture = Image.fromarray(np.array([[[255, 0, 0]], [[0, 0, 255]]], dtype=np.uint8))  # red above blue
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture, baseColorFactor=[255, 255, 128, 255])
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 1]], material=material)
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], visual=visual, process=False).export(
        tmp_path / "m.glb"
    )
    textures = load_mesh(tmp_path / "m.glb", 2)[2]
    assert textures is not None
    assert torch.allclose(textures[0, 0, 0, 1], torch.tensor([1.0, 0, 0]), atol=0.01)  # corner 2 is on top
    assert torch.allclose(textures[0, 1, 0, 0], torch.tensor([0, 0, 0.737]), atol=0.01)


def test_errors(tmp_path):
    vertices, faces = cube()
    with pytest.raises(ValueError, match=r"\.obj, \.ply, \.stl, \.off, \.glb, \.gltf, got 'm\.fbx'"):
        load_mesh(tmp_path / "m.fbx")
    with pytest.raises(ValueError, match=r"\.obj, \.ply, \.glb, got 'm\.stl'"):
        save_mesh(tmp_path / "m.stl", vertices, faces)
    with pytest.raises(FileNotFoundError, match=r"m\.ply: expected a file, got nothing there"):
        load_mesh(tmp_path / "m.ply")
    for suffix in ("ply", "stl", "off", "glb", "gltf"):
        path = tmp_path / f"broken.{suffix}"
        path.write_bytes(b"\x00\x01 nonsense \xff" * 20)
        with pytest.raises(ValueError, match=rf"broken\.{suffix}"):
            load_mesh(path)
    bad = vertices.numpy().copy()
    bad[3, 1] = np.nan
    trimesh.Trimesh(bad, faces.numpy(), process=False).export(tmp_path / "nan.ply")
    with pytest.raises(ValueError, match=r"nan\.ply: expected finite vertices"):
        load_mesh(tmp_path / "nan.ply")
    (tmp_path / "range.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    with pytest.raises(ValueError, match=r"range\.off"):
        load_mesh(tmp_path / "range.off")


def test_a_broken_picture_in_a_file_is_an_error_of_that_file(tmp_path):
    path = tmp_path / "ball.glb"
    save_mesh(path, *coloured_sphere())
    data = bytearray(path.read_bytes())
    begin = data.find(b"IDAT")
    data[begin - 4 : begin] = (100).to_bytes(4, "big")
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"ball\.glb: cannot be read as GLB \(image 0: expected a picture"):
        load_mesh(path)


def test_parts_that_share_a_picture_share_it_in_memory(tmp_path):
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (8, 8, 3), dtype=np.uint8))
    scene = trimesh.Scene()
    for number in range(6):
        material = trimesh.visual.material.PBRMaterial(
            baseColorTexture=picture,
            roughnessFactor=number / 10,
            baseColorFactor=[255, 255 if number < 4 else 9, 255, 255],
        )
        visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 1]], material=material)
        part = trimesh.Trimesh([[0, 0, number], [1, 0, number], [0, 1, number]], [[0, 1, 2]], visual=visual)
        scene.add_geometry(part, node_name=str(number))
    files = trimesh.exchange.gltf.export_gltf(scene)
    tree = json.loads(files["model.gltf"])
    tree |= {"images": tree["images"][:1], "textures": [{"source": 0}] * 6}  # which trimesh writes one by one
    files["model.gltf"] = json.dumps(tree).encode()
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    mesh = UVMesh.load(tmp_path / "model.gltf")
    assert len(mesh.images) == 2 and sorted(mesh.image_index.bincount().tolist()) == [2, 4]


@pytest.mark.parametrize("number", ["1e39", "-1e300", "inf", "nan"])
def test_vertices_beyond_float32(tmp_path, number):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
    faces = f"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 {number}\n0 1 0\n3 0 1 2\n"
    (tmp_path / "m.ply").write_text(header + faces)
    (tmp_path / "m.off").write_text(f"OFF\n3 1 0\n0 0 0\n1 0 {number}\n0 1 0\n3 0 1 2\n")
    for name in ("m.ply", "m.off"):
        with pytest.raises(ValueError, match=rf"{name}: expected finite vertices that float32 can hold, got \d bad"):
            load_mesh(tmp_path / name)


def test_text_of_no_encoding(tmp_path):
    (tmp_path / "a.stl").write_bytes(bytes(range(128, 256)) * 30)
    with pytest.raises(ValueError, match=r"a\.stl: expected 3553808848 triangles .* the file is cut or no STL"):
        load_mesh(tmp_path / "a.stl")


def test_missing_materials_are_grey_and_no_materials_are_none(tmp_path):
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "plain.obj").write_text(triangle)
    (tmp_path / "lost.obj").write_text("mtllib lost.mtl\n" + triangle)
    assert load_mesh(tmp_path / "plain.obj")[2] is None
    with pytest.warns(UserWarning, match="lost.mtl"):
        assert (load_mesh(tmp_path / "lost.obj")[2] == 0.5).all()


def test_files_that_are_cut(tmp_path) -> None:
    (tmp_path / "empty.glb").touch()
    with pytest.raises(ValueError, match=r"empty\.glb: cannot be read as GLB \(it is cut\)"):
        load_mesh(tmp_path / "empty.glb")
