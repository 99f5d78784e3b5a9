"""Each way in which glTF files give shapes and colours, with the values that the specification gives."""

from __future__ import annotations

import base64
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from tests.gltf import reference
from tests.gltf.compare import compare
from tests.gltf.files import FACES, SQUARE, UV, File, textured

RED_OVER_BLUE = [[[255, 0, 0]]] * 8 + [[[0, 0, 255]]] * 8
GREY = [[[128, 128, 128]]]
HALF = 128 / 255


def color(mesh: Any, x: float = 0.0, y: float = 0.0, **options: Any) -> list[float]:
    """Draw a mesh of the square from −1 to 1, and return the colour at a place."""
    camera = nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True)
    options = {"light": None, "anti_aliasing": False} | options
    rgb = nr.render(mesh, camera, 65, **options).rgb[0]
    return rgb[:, round(32 - 32 * y), round(32 + 32 * x)].tolist()


def read(file: File, folder: Path, warns: str | None = None) -> nr.UVMesh:
    """Write and read a file; it has to look as by the independent reader, without warnings but ``warns``."""
    path = file.save(folder / "m.glb")
    if warns is not None:
        with pytest.warns(UserWarning, match=warns):
            mesh = nr.UVMesh.load(path)
    else:
        mesh = nr.UVMesh.load(path)
    kind, why = compare(path)
    assert kind == "right", why
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        baked = nr.Mesh.load(path, 1)
        path = file.save(folder / "m.gltf")
        again = nr.UVMesh.load(path)
        rig = nr.Rig.load(path)
    assert torch.equal(baked.vertices, mesh.vertices) and torch.equal(baked.faces, mesh.faces)
    assert torch.equal(again.vertices, mesh.vertices) and torch.equal(again.uv, mesh.uv)
    torch.testing.assert_close(rig.posed().vertices, mesh.vertices, rtol=1e-5, atol=1e-5)
    assert torch.equal(rig.mesh.faces, mesh.faces)
    return mesh


def test_the_example_of_this_file_is_white(tmp_path: Path) -> None:
    """Without a material, the default one of the specification: white, also in `Mesh` and by the commands' grey."""
    mesh = read(plain(), tmp_path)
    assert color(mesh) == pytest.approx([1, 1, 1])
    assert color(nr.UVMesh.load(tmp_path / "m.glb", grey=0.25)) == pytest.approx([1, 1, 1])
    assert color(nr.Mesh.load(tmp_path / "m.glb")) == pytest.approx([1, 1, 1])
    assert float(mesh.materials[0].metallic) == 1 and not mesh.materials[0].double_sided


def plain() -> File:
    file = File()
    return file.scene(file.square())


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_texture_coordinates_of_all_types(tmp_path: Path, dtype: str) -> None:
    file = File()
    full = 1.0 if dtype == "float32" else np.iinfo(dtype).max
    uv = file.array(UV * full, dtype, **({} if dtype == "float32" else {"normalized": True}))
    mesh = read(file.scene(file.square(textured(file, RED_OVER_BLUE), TEXCOORD_0=uv)), tmp_path)
    assert color(mesh, y=0.75) == pytest.approx([1, 0, 0]) and color(mesh, y=-0.75) == pytest.approx([0, 0, 1])


def test_quantised_as_gltfpack_does(tmp_path: Path) -> None:
    """Positions as whole numbers with the scale of a node, coordinates as normalised ones, with a transform."""
    file = File()
    file.json |= {
        name: ["KHR_mesh_quantization", "KHR_texture_transform"] for name in ("extensionsUsed", "extensionsRequired")
    }
    transform = {"KHR_texture_transform": {"offset": [0.0, 0.5], "scale": [2.0, 0.5]}}
    primitive = file.square(textured(file, RED_OVER_BLUE, extensions=transform))
    primitive["attributes"] = {
        "POSITION": file.array(SQUARE * 16383, np.int16),
        "NORMAL": file.array(np.tile([0, 0, 127], (4, 1)), np.int8, normalized=True),
        "TEXCOORD_0": file.array(UV * 65535, np.uint16, normalized=True),
    }
    mesh = read(file.scene(primitive, scale=[1 / 16383] * 3), tmp_path)
    assert mesh.vertices.abs().max() == pytest.approx(1)
    assert color(mesh, y=0.5) == pytest.approx([0, 0, 1]) and mesh.normals is not None
    assert mesh.normals[..., 2].min() == 1


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("width", [3, 4])
def test_factor_times_texture_times_color(tmp_path: Path, kind: str, width: int) -> None:
    """The product in linear light; alpha of vertices multiplies the material's."""
    file = File()
    full = 1.0 if kind == "float32" else np.iinfo(kind).max
    tint = file.array(np.array([[1.0, 0, 0.2, 0.4]] * 4)[:, :width] * full, kind, normalized=kind != "float32")
    material = textured(file, GREY) | {"alphaMode": "BLEND"}
    material["pbrMetallicRoughness"]["baseColorFactor"] = [0.5, 1, 1, 0.5]
    mesh = read(file.scene(file.square(material, TEXCOORD_0=file.array(UV), COLOR_0=tint)), tmp_path)
    grey = reference.to_linear(np.array(HALF))
    expected = reference.to_display(np.array([0.5 * grey, 0, 0.2 * grey]))
    assert color(mesh) == pytest.approx(expected.tolist(), abs=2e-3)
    assert color(nr.Mesh.load(tmp_path / "m.glb")) == pytest.approx(expected.tolist(), abs=2e-3)
    drawn = nr.render(mesh, nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True), 9, layers=2, outputs=("alpha",))
    assert float(drawn.alpha[0, 4, 4]) == pytest.approx(0.2 if width == 4 else 0.5, abs=2e-3)


def test_colors_are_interpolated_in_linear_light(tmp_path: Path) -> None:
    """From black to white; half of it is 0.735 as a display value."""
    file = File()
    ramp = file.array((SQUARE[:, :1] + 1) / 2 * np.ones((1, 3)), np.float32)
    mesh = read(file.scene(file.square(None, COLOR_0=ramp)), tmp_path)
    for shading in ("flat", "smooth", "phong", "pbr"):
        assert color(mesh, shading=shading) == pytest.approx([0.7354] * 3, abs=1e-3)
    assert color(mesh, x=0.5) == pytest.approx([float(reference.to_display(np.array(0.75)))] * 3, abs=3e-3)
    triangle = nr.load_mesh(tmp_path / "m.glb", 1)[2]
    assert triangle is not None  # one texel has the colour of the centre, at two thirds and one third
    assert triangle[:, 0, 0, 0, 0].sort().values.tolist() == pytest.approx(
        reference.to_display(np.array([1 / 3, 2 / 3])).tolist(), abs=1e-5
    )


def test_black_colors_are_followed_with_a_sentence(tmp_path: Path) -> None:
    file = File()
    black = file.array(np.zeros((4, 3)), np.float32)
    mesh = read(file.scene(file.square({}, COLOR_0=black)), tmp_path, warns="COLOR_0 of mesh 0, primitive 0 is black")
    assert color(mesh) == [0, 0, 0]


def test_colors_that_are_mostly_black_get_the_sentence_too(tmp_path: Path) -> None:
    """As those of an avatar whose lips alone have another colour than black."""
    file = File()
    places, colors = np.repeat(SQUARE, 3, 0), np.zeros((12, 4), np.float32)
    colors[0, 0] = 0.3
    primitive = {"attributes": {"POSITION": file.array(places), "COLOR_0": file.array(colors)}}
    primitive["indices"] = file.array(FACES * 3)
    mesh = read(file.scene(primitive), tmp_path, warns="COLOR_0 of mesh 0, primitive 0 is black at 11 of 12 vertices")
    assert color(mesh, x=-0.95, y=-0.95)[0] > 0.5 and color(mesh, x=0.95, y=0.95)[0] < 0.2


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_all_sets_of_coordinates(tmp_path: Path, number: int) -> None:
    """The base colour reads set n; the others look at the other half."""
    file = File()
    sets = {f"TEXCOORD_{n}": file.array(UV * 0 + (0.75 if n == number else 0.25), np.float32) for n in range(4)}
    mesh = read(file.scene(file.square(textured(file, RED_OVER_BLUE, texCoord=number), **sets)), tmp_path)
    assert color(mesh) == pytest.approx([0, 0, 1])


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_textures_of_one_material_have_any_sets_of_coordinates(tmp_path: Path, number: int) -> None:
    """The emission reads set n; the others look at the other half. A second material has fewer sets."""
    file = File()
    sets = {f"TEXCOORD_{n}": file.array(UV * 0 + (0.75 if n == number else 0.25), np.float32) for n in range(4)}
    material = textured(file, GREY) | {"emissiveFactor": [1, 1, 1]}
    colors = file.texture(RED_OVER_BLUE)
    material["normalTexture"] = {"index": file.texture([[[128, 128, 255]]]), "texCoord": 3}
    material["occlusionTexture"] = {"index": 0, "texCoord": 2}
    material["emissiveTexture"] = {"index": colors, "texCoord": number}
    plain = file.square(textured(file, GREY), TEXCOORD_0=sets["TEXCOORD_0"])
    mesh = read(file.scene(file.square(material, **sets), plain), tmp_path)
    assert {texture.uv_set for texture in mesh.materials[0].textures().values()} <= {0, 1, 2, 3}
    mesh.save(tmp_path / "again.glb")
    for one in (mesh, nr.UVMesh.load(tmp_path / "again.glb"), nr.join([mesh, nr.UVMesh.load(tmp_path / "again.glb")])):
        front = one.submesh(range(2))
        with_light = color(front, light=nr.Light(ambient=0.0, directional=0.0), shading="pbr")
        assert with_light == pytest.approx([0, 0, 1], abs=1e-6)


def old(file: File, **values: Any) -> File:
    """A square with a material of the specular-glossiness model."""
    file.json["extensionsUsed"] = ["KHR_materials_pbrSpecularGlossiness"]
    material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": values}}
    return file.scene(file.square(material, TEXCOORD_0=file.array(UV)))


def test_specular_glossiness_of_factors(tmp_path: Path) -> None:
    values = {"diffuseFactor": [1, 0, 0, 1], "specularFactor": [0, 0, 0], "glossinessFactor": 0.75}
    mesh = read(old(File(), **values), tmp_path)
    assert color(mesh) == pytest.approx([1, 0, 0])
    assert float(mesh.materials[0].metallic) == 0 and float(mesh.materials[0].roughness) == 0.25


def test_specular_glossiness_of_a_texture_is_not_white(tmp_path: Path) -> None:
    file = File()
    mesh = read(old(file, diffuseTexture={"index": file.texture(GREY)}, specularFactor=[0.2] * 3), tmp_path)
    assert color(mesh) == pytest.approx([HALF] * 3)
    file = File()
    mesh = read(old(file, diffuseTexture={"index": file.texture(GREY)}), tmp_path)  # specular white by default
    assert color(mesh) == pytest.approx([HALF] * 3)


def test_specular_glossiness_of_a_metal(tmp_path: Path) -> None:
    """Gold has no diffuse colour: its base colour is the specular one."""
    gold = [1.0, 0.77, 0.34]
    file = old(File(), diffuseFactor=[0, 0, 0, 1], specularFactor=gold, glossinessFactor=0.5)
    mesh = nr.UVMesh.load(file.save(tmp_path / "m.glb"))
    assert color(mesh) == pytest.approx(reference.to_display(np.array(gold)).tolist(), abs=1e-5)
    assert float(mesh.materials[0].metallic) == 1 and float(mesh.materials[0].roughness) == 0.5


def test_specular_glossiness_by_texel(tmp_path: Path) -> None:
    """Left a plastic, right a rough, white metal; textures of the metallic-roughness model have both."""
    file = File()
    shine = file.texture([[[0, 0, 0, 255], [255, 255, 255, 51]]])
    diffuse = file.texture([[[128, 128, 128], [0, 0, 0]]])
    values = {"diffuseTexture": {"index": diffuse}, "specularGlossinessTexture": {"index": shine}}
    mesh = nr.UVMesh.load(old(file, **values).save(tmp_path / "m.glb"))
    texture = mesh.materials[0].metallic_roughness_texture
    assert texture is not None
    torch.testing.assert_close(texture.image[0, :, 1:], torch.tensor([[0.0, 0.0], [0.8, 1.0]]))
    torch.testing.assert_close(mesh.images[0][0], torch.tensor([[HALF] * 3, [1.0] * 3]))


@pytest.mark.parametrize("shading", ["flat", "smooth", "phong", "pbr", nr.Phong(), nr.PBR()])
def test_light_leaves_unlit_materials_alone(tmp_path: Path, shading: Any) -> None:
    """Seen obliquely, under a light from behind; one half of the mesh is lit."""
    file = File()
    file.json["extensionsUsed"] = ["KHR_materials_unlit"]
    pbr = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 0.9}
    lit = file.square({"pbrMetallicRoughness": pbr})
    lit["indices"] = file.array(FACES[:3])
    unlit = file.square({"pbrMetallicRoughness": pbr, "extensions": {"KHR_materials_unlit": {}}})
    unlit["indices"] = file.array(FACES[3:])
    turned = {"rotation": [0, np.sin(0.4), 0, np.cos(0.4)]}
    mesh = nr.UVMesh.load(file.scene(lit, unlit, **turned).save(tmp_path / "m.glb"))
    light = nr.Light(ambient=0.1, direction=(0.2, 0.3, 1.0), directional=0.6)
    options = {"light": light, "shading": shading}
    assert color(mesh, -0.3, 0.5, **options) == pytest.approx([1, 1, 1])
    assert max(color(mesh, 0.3, -0.5, **options)) < 0.95
    assert color(mesh, -0.3, 0.5, layers=1, **options) == pytest.approx([1, 1, 1])
    together = nr.render(
        [mesh, mesh.replace(materials=(), material_index=None)],
        nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True),
        9,
    )
    assert together.rgb[0].max() > together.rgb[1].max()
    mesh.save(tmp_path / "again.glb")
    assert color(nr.UVMesh.load(tmp_path / "again.glb"), -0.3, 0.5, **options) == pytest.approx([1, 1, 1])
    with pytest.warns(UserWarning, match="unlit materials, which texture cubes do not keep"):
        nr.load_mesh(tmp_path / "again.glb")


def morphing(file: File, **more: Any) -> File:
    up = file.array(np.tile([0, 0, 1], (4, 1)), np.float32)
    primitive = file.square() | {"targets": [{"POSITION": up}]}
    return file.scene(primitive, **more)


def test_morph_targets_at_rest(tmp_path: Path) -> None:
    """Weights of the mesh, those of the node before them."""
    file = morphing(File())
    file.json["meshes"][0]["weights"] = [1.0]
    assert (read(file, tmp_path).vertices[:, 2] == 1).all()
    file = morphing(File(), weights=[0.5])
    file.json["meshes"][0]["weights"] = [1.0]
    assert (read(file, tmp_path).vertices[:, 2] == 0.5).all()
    assert (read(morphing(File()), tmp_path).vertices[:, 2] == 0).all()


def skinned(file: File) -> File:
    """A square bound to a joint at (0, 5, 0) of scale 0.01; its own node is somewhere else."""
    bound = {
        "JOINTS_0": file.array(np.zeros((4, 4)), np.uint8),
        "WEIGHTS_0": file.array(np.tile([255, 0, 0, 0], (4, 1)), np.uint8, normalized=True),
    }
    file.scene(file.square(None, **bound), skin=0, translation=[7, 7, 7], scale=[3, 3, 3])
    joint = file.add("nodes", {"translation": [0, 5, 0], "scale": [0.01] * 3})
    file.json["scenes"][0]["nodes"].append(joint)
    file.json["skins"] = [{"joints": [joint]}]
    return file


def test_joints_place_a_skin_and_its_node_does_not(tmp_path: Path) -> None:
    mesh = read(skinned(File()), tmp_path)
    torch.testing.assert_close(mesh.vertices.min(0).values, torch.tensor([-0.01, 4.99, 0]))
    torch.testing.assert_close(mesh.vertices.max(0).values, torch.tensor([0.01, 5.01, 0]))


def test_a_skin_of_two_joints_with_matrices(tmp_path: Path) -> None:
    """Against the formula: Σ weight · joint · inverse bind matrix."""
    file = File()
    weights = np.array([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0.25, 0.75, 0, 0], [0, 1, 0, 0]], np.float32)
    bound = {
        "JOINTS_0": file.array(np.tile([1, 0, 0, 0], (4, 1)), np.uint16),
        "WEIGHTS_0": file.array(weights),
        "NORMAL": file.array(np.tile([0, 0, 1], (4, 1)), np.float32),
    }
    file.scene(file.square(None, **bound), skin=0)
    turn = [np.sin(0.5), 0, 0, np.cos(0.5)]
    first = file.add("nodes", {"translation": [1, 2, 3], "rotation": turn})
    second = file.add("nodes", {"translation": [0, 1, 0], "scale": [1, 2, 1], "children": [first]})
    file.json["scenes"][0]["nodes"].append(second)
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[:, :3, 3] = [[0, 0, 1], [1, 0, 0]]
    matrices = file.array(inverse.transpose(0, 2, 1).reshape(2, 16), np.float32)
    file.json["skins"] = [{"joints": [first, second], "inverseBindMatrices": matrices}]
    mesh = read(file, tmp_path)
    assert mesh.normals is not None and mesh.normals[..., 1].abs().max() > 0.1


def test_instances(tmp_path: Path) -> None:
    file = File()
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    places = file.array([[0, 0, 0], [5, 0, 0]], np.float32)
    turns = file.array([[0, 0, 0, 127], [0, 0, 127, 0]], np.int8, normalized=True)
    copies = {"attributes": {"TRANSLATION": places, "ROTATION": turns, "_ID": places}}
    file.scene(file.square(), translation=[0, 1, 0], extensions={"EXT_mesh_gpu_instancing": copies})
    mesh = read(file, tmp_path)
    assert mesh.vertices.max(0).values.tolist() == pytest.approx([6, 2, 0], abs=1e-6)
    assert (mesh.num_faces, mesh.num_vertices) == (4, 8)


@pytest.mark.parametrize(
    ("mode", "drawn", "faces"),
    [
        (4, [0, 1, 2, 0, 2, 3], [[0, 1, 2], [0, 2, 3]]),
        (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
        (5, [0, 1], []),
    ],
)
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32", None])
def test_all_modes_of_triangles(
    tmp_path: Path, mode: int, drawn: list[int], faces: list[Any], dtype: str | None
) -> None:
    file = File()
    if dtype is None:  # in order, without indices
        primitive = {"attributes": {"POSITION": file.array(SQUARE[drawn])}, "mode": mode}
        faces = [[drawn.index(corner) if mode != 4 else 0 for corner in face] for face in faces]
        faces = [[0, 1, 2], [3, 4, 5]] if mode == 4 else faces
    else:
        primitive = file.square() | {"mode": mode, "indices": file.array(drawn, dtype)}
    file.scene(primitive)
    if not faces:
        with pytest.raises(ValueError, match=r"expected faces, got \d vertices but no faces"):
            nr.UVMesh.load(file.save(tmp_path / "m.glb"))
        return
    assert read(file, tmp_path).faces.tolist() == faces


def test_points_and_lines_are_counted(tmp_path: Path) -> None:
    file = File()
    more = [file.square() | {"mode": mode} for mode in (0, 1, 2, 3, 0)]
    mesh = read(
        file.scene(file.square(), *more), tmp_path, warns="2 primitives of points and 3 primitives of lines are"
    )
    assert mesh.num_faces == 2
    file = File()
    with pytest.raises(ValueError, match="no faces; 1 primitive of points is left out"):
        nr.UVMesh.load(file.scene(file.square() | {"mode": 0}).save(tmp_path / "m.glb"))


def test_sparse_accessors(tmp_path: Path) -> None:
    """Changes of an array, and of zeros that no view stores."""
    file = File()
    primitive = file.square()
    index, values = file.array([2], np.uint8), file.array([[1, 1, 5]], np.float32)
    places = [file.json["accessors"][n]["bufferView"] for n in (index, values)]
    sparse = {
        "count": 1,
        "indices": {"bufferView": places[0], "componentType": 5121},
        "values": {"bufferView": places[1]},
    }
    file.json["accessors"][primitive["attributes"]["POSITION"]]["sparse"] = sparse
    assert read(file.scene(primitive), tmp_path).vertices[2].tolist() == [1, 1, 5]
    del file.json["accessors"][primitive["attributes"]["POSITION"]]["bufferView"]
    found = read(file, tmp_path).vertices
    assert found.tolist() == [[0, 0, 0], [0, 0, 0], [1, 1, 5], [0, 0, 0]]


def test_interleaved_arrays(tmp_path: Path) -> None:
    file = File()
    rows = np.zeros(4, [("p", "<f4", 3), ("t", "<u2", 2)])
    rows["p"], rows["t"] = SQUARE, UV * 65535
    view = file.view(rows.tobytes(), byteStride=16)
    position = {"bufferView": view, "count": 4, "type": "VEC3", "componentType": 5126}
    uv = {"bufferView": view, "byteOffset": 12, "count": 4, "type": "VEC2", "componentType": 5123, "normalized": True}
    primitive = file.square(textured(file, RED_OVER_BLUE))
    primitive["attributes"] = {"POSITION": file.add("accessors", position), "TEXCOORD_0": file.add("accessors", uv)}
    assert color(read(file.scene(primitive), tmp_path), y=0.75) == pytest.approx([1, 0, 0])


def test_files_without_scenes_or_nodes(tmp_path: Path) -> None:
    file = plain()
    below = file.add("nodes", {"mesh": 0, "translation": [0, 0, 2]})
    file.json["nodes"][0]["children"] = [below]
    file.json["nodes"][0]["translation"] = [0, 0, 1]
    del file.json["scenes"]
    assert read(file, tmp_path).vertices[:, 2].unique().tolist() == [1, 3]
    del file.json["nodes"]
    path = file.save(tmp_path / "n.glb")
    assert nr.UVMesh.load(path).num_faces == 2 and compare(path)[0] == "right"


def test_the_scene_that_the_file_chooses(tmp_path: Path) -> None:
    file = plain()
    other = file.add(
        "nodes", {"mesh": 0, "scale": [-2, 1, 1], "matrix": [-2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]}
    )
    file.json["scene"] = file.add("scenes", {"nodes": [other]})
    mesh = read(file, tmp_path)
    assert mesh.vertices[:, 0].unique().tolist() == [1, 5]
    assert mesh.faces[0].tolist() == [0, 2, 1]  # mirrored, so turned over


def test_invisible_nodes(tmp_path: Path) -> None:
    file = plain()
    file.json["extensionsUsed"] = ["KHR_node_visibility"]
    hidden = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}, "children": [2]}
    file.json["scenes"][0]["nodes"].append(file.add("nodes", hidden))
    file.add("nodes", {"mesh": 0})
    assert read(file, tmp_path).num_faces == 2


def test_several_buffers_and_odd_chunks(tmp_path: Path) -> None:
    """A chunk of another kind between those of the file, and a buffer beside it with an escaped name."""
    file = plain()
    data = file.save(tmp_path / "m.glb").read_bytes()
    end = 20 + int.from_bytes(data[12:16], "little")
    odd = b"\5\0\0\0abcd12345"
    (tmp_path / "m.glb").write_bytes(data[:end] + odd + data[end:] + odd)
    assert nr.UVMesh.load(tmp_path / "m.glb").num_faces == 2

    begin = file.json["bufferViews"][0]["byteLength"]
    (tmp_path / "an ü.bin").write_bytes(file.data[:begin])
    file.json["bufferViews"][1] |= {"buffer": 1}
    file.data, whole = bytes(begin) + file.data[begin:], file.data
    tree = dict(file.json)
    tree["buffers"] = [
        {"byteLength": begin, "uri": "an%20%C3%BC.bin"},
        {
            "byteLength": len(whole),
            "uri": "data:application/gltf-buffer;base64," + base64.b64encode(file.data).decode(),
        },
    ]
    (tmp_path / "m.gltf").write_text(json.dumps(tree))
    assert nr.UVMesh.load(tmp_path / "m.gltf").vertices.tolist() == SQUARE.tolist()
    # The content tells the form, not the name.
    (tmp_path / "n.glb").write_bytes((tmp_path / "m.gltf").read_bytes())
    assert nr.UVMesh.load(tmp_path / "n.glb").num_faces == 2


def test_webp_and_its_fallback(tmp_path: Path) -> None:
    file = File()
    file.json["extensionsUsed"] = ["EXT_texture_webp"]
    other = file.picture([[[0, 255, 0]] * 8] * 8, "WEBP", lossless=True)
    material = textured(file, GREY)
    file.json["textures"][0]["extensions"] = {"EXT_texture_webp": {"source": other}}
    mesh = read(file.scene(file.square(material, TEXCOORD_0=file.array(UV))), tmp_path)
    assert color(mesh) == pytest.approx([0, 1, 0])


def test_primitives_share_vertices(tmp_path: Path) -> None:
    """Those of one mesh that name the same positions have the same vertices."""
    file = File()
    red = file.square({"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}})
    green = red | {"indices": file.array(FACES[3:]), "material": file.add("materials", {})}
    red["indices"] = file.array(FACES[:3])
    mesh = read(file.scene(red, green), tmp_path)
    assert mesh.num_vertices == 4 and color(mesh, 0.5, -0.5) == pytest.approx([1, 0, 0])


def test_emissive_strength_and_variants(tmp_path: Path) -> None:
    file = File()
    file.json["extensionsUsed"] = ["KHR_materials_emissive_strength", "KHR_materials_variants"]
    file.json["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "blue"}]}}
    strong = {"KHR_materials_emissive_strength": {"emissiveStrength": 4}}
    primitive = file.square({"emissiveFactor": [1, 0.5, 0], "extensions": strong})
    blue = file.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 1, 1]}})
    primitive["extensions"] = {"KHR_materials_variants": {"mappings": [{"material": blue, "variants": [0]}]}}
    mesh = read(file.scene(primitive), tmp_path)
    assert mesh.materials[0].emissive.tolist() == [4, 2, 0] and color(mesh) == pytest.approx([1, 1, 1])
