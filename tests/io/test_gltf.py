"""Materials of glTF: written, read by us and by others, and read from files that others wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

import neural_renderer as nr
from neural_renderer.io import formats
from tests.paths import EXAMPLES

FACTORS = ("opacity", "metallic", "roughness", "emissive", "occlusion_strength", "normal_scale")


def image(seed: int, *shape: int) -> Tensor:
    """Pixels that a PNG keeps exactly."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, shape, generator=generator).float() / 255


def quad(picture: Tensor, wrap: Any = "repeat") -> nr.UVMesh:
    """Two triangles over [0, 1]², with coordinates beyond [0, 1]."""
    vertices = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return nr.UVMesh(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]), 3 * vertices[:, :2] - 1, picture, wrap=wrap)


def material() -> nr.Material:
    """One that has everything."""
    packed = image(1, 4, 8, 3)
    return nr.Material(
        "glass",
        opacity=0.25,
        opacity_texture=nr.Texture(image(0, 8, 8, 1), wrap=("mirror", "clamp")),
        alpha_mode="MASK",
        alpha_cutoff=0.75,
        metallic=0.5,
        roughness=0.125,
        metallic_roughness_texture=nr.Texture(packed, wrap="mirror"),
        emissive=(4.0, 2.0, 1.0),
        emissive_texture=nr.Texture(image(2, 2, 2, 3), offset=(0.5, 0.25), scale=(2.0, 3.0), rotation=0.5),
        occlusion_texture=nr.Texture(packed, wrap="mirror", uv_set=1),
        occlusion_strength=0.5,
        normal_texture=nr.Texture(image(3, 8, 8, 3), wrap="clamp"),
        normal_scale=-2.0,
        double_sided=False,
    )


def mesh() -> nr.UVMesh:
    unit = torch.nn.functional.normalize
    own = quad(image(4, 8, 8, 3), wrap=("mirror", "clamp"))
    turned = torch.rand(2, 3, 4, generator=torch.Generator().manual_seed(0)) - 0.5
    return nr.UVMesh(
        own.vertices,
        own.faces,
        own.uv,
        own.image_index,
        own.images,
        own.colors,
        own.wraps,
        materials=(material(), nr.Material("red", base_color=(0.5, 0.25, 0.125))),
        material_index=torch.tensor([0, 1]),
        normals=unit(turned[..., :3], dim=-1),
        tangents=torch.cat((unit(turned[..., 1:], dim=-1), turned[..., :1].sign()), -1),
        uv1=own.uv * 0.5,
    )


def test_everything_comes_back(tmp_path: Path) -> None:
    """Numbers in JSON and arrays are exact; images are bytes; normals are scaled to 1 again."""
    first = mesh()
    first.save(tmp_path / "m.glb")
    again = nr.UVMesh.load(tmp_path / "m.glb")
    order = [0, 1] if again.materials[0].name == "glass" else [1, 0]
    known, found = first.materials[0], again.materials[order[0]]
    assert (found.name, found.alpha_mode, found.alpha_cutoff, found.double_sided) == ("glass", "MASK", 0.75, False)
    for name in FACTORS:
        assert torch.equal(getattr(found, name), getattr(known, name)), name
    for name, texture in known.textures().items():
        other = getattr(found, name)
        assert other.wrap == nr.Texture(texture.image, wrap=texture.wrap).wrap or other.wrap == (texture.wrap,) * 2
        for part in ("offset", "scale", "rotation"):
            assert torch.equal(getattr(other, part), getattr(texture, part)), (name, part)
        assert other.uv_set == texture.uv_set
        torch.testing.assert_close(other.image[..., : texture.image.shape[2]], texture.image, rtol=0, atol=1e-6)
    assert found.occlusion_texture.image is found.metallic_roughness_texture.image
    assert again.materials[order[1]].alpha_mode == "OPAQUE" and again.materials[order[1]].opacity == 1

    faces = [int((again.material_index == one).nonzero()) for one in order]
    assert again.wraps[0] == ("mirror", "clamp")
    for name in ("normals", "tangents"):
        torch.testing.assert_close(getattr(again, name)[faces], getattr(first, name), rtol=0, atol=1e-6)
    # The vertical coordinate was turned over twice.
    torch.testing.assert_close(again.uv[faces], first.uv, rtol=0, atol=1e-6)
    torch.testing.assert_close(again.uv1[faces[0]], first.uv1[0], rtol=0, atol=1e-6)
    torch.testing.assert_close(again.images[int(again.image_index[faces[0]])], first.images[0], rtol=0, atol=1e-6)


def test_the_picture_stays_the_same(tmp_path: Path) -> None:
    """Beyond [0, 1], too."""
    camera = nr.Camera.look_at((0.2, 0.3, -2.5), viewing_angle=25)
    first = nr.UVMesh(
        *(getattr(mesh(), name) for name in ("vertices", "faces", "uv")), image(4, 8, 8, 3), wrap="mirror"
    )
    first.save(tmp_path / "m.glb")
    drawn = [nr.render(one, camera, 32).rgb for one in (first, nr.UVMesh.load(tmp_path / "m.glb"))]
    torch.testing.assert_close(drawn[1], drawn[0], rtol=0, atol=1e-5)


def test_others_read_it(tmp_path: Path) -> None:
    """trimesh finds the factors and images that it knows; the JSON has what the specification requires."""
    mesh().save(tmp_path / "m.glb")
    parts = trimesh.load(tmp_path / "m.glb").geometry.values()
    found = next(part.visual.material for part in parts if part.visual.material.name == "glass")
    assert (found.metallicFactor, found.roughnessFactor, found.alphaMode, found.alphaCutoff) == (
        0.5,
        0.125,
        "MASK",
        0.75,
    )
    assert found.doubleSided is False and found.emissiveTexture.size == (2, 2) and found.baseColorTexture.mode == "RGBA"
    tree = parsed(tmp_path / "m.glb")
    assert tree["asset"]["version"] == "2.0"
    assert tree["extensionsUsed"] == ["KHR_materials_emissive_strength", "KHR_texture_transform"]
    glass = next(one for one in tree["materials"] if one.get("name") == "glass")
    assert glass["emissiveFactor"] == [1.0, 0.5, 0.25] and glass["occlusionTexture"]["texCoord"] == 1
    used = glass["emissiveTexture"]["extensions"]["KHR_texture_transform"]
    assert used == {"offset": [0.5, 0.25], "scale": [2.0, 3.0], "rotation": 0.5}
    for accessor in tree["accessors"]:
        view = tree["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0


def parsed(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def changed(path: Path, change: Any) -> Path:
    """Write a GLB again, with its JSON changed."""
    data = path.read_bytes()
    tree, rest = parsed(path), data[20 + int.from_bytes(data[12:16], "little") :]
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    sizes = (20 + len(text) + len(rest)).to_bytes(4, "little"), len(text).to_bytes(4, "little")
    path.write_bytes(data[:8] + sizes[0] + sizes[1] + data[16:20] + text + rest)
    return path


def test_the_transform_of_the_base_color_is_in_the_coordinates(tmp_path: Path) -> None:
    """Other textures keep the same place: they follow, or have the coordinates of the file as the second ones."""
    mesh().save(tmp_path / "m.glb")
    moved = {"KHR_texture_transform": {"offset": [0.25, 0.5], "scale": [2, 1]}}

    def change(tree: dict[str, Any]) -> None:
        glass = next(one for one in tree["materials"] if one.get("name") == "glass")
        glass["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = moved
        glass["normalTexture"]["extensions"] = moved
        del glass["occlusionTexture"]

    first, found = mesh(), nr.UVMesh.load(changed(tmp_path / "m.glb", change))
    number = next(n for n, one in enumerate(found.materials) if one.name == "glass")
    face = int((found.material_index == number).nonzero())
    texture = nr.Texture(torch.zeros(1, 1, 1), offset=(0.25, 0.5), scale=(2.0, 1.0))
    expected = texture.transformed(first.uv[0])
    torch.testing.assert_close(found.uv[face], expected, rtol=0, atol=1e-6)
    glass = found.materials[number]
    torch.testing.assert_close(glass.normal_texture.transformed(found.uv[face]), expected, rtol=0, atol=1e-6)
    own = first.materials[0].emissive_texture
    assert glass.emissive_texture.uv_set == 1
    torch.testing.assert_close(
        glass.emissive_texture.transformed(found.uv1[face]), own.transformed(first.uv[0]), rtol=0, atol=1e-6
    )


def test_normals_turn_with_their_part(tmp_path: Path) -> None:
    """A part that is mirrored, stretched and turned: normals stay perpendicular, tangents stay along the surface."""
    own = mesh()
    flat = torch.tensor([0.0, 0.0, 1.0]).expand(2, 3, 3)
    along = torch.tensor([1.0, 0.0, 0.0, 1.0]).expand(2, 3, 4)
    own = nr.UVMesh(own.vertices, own.faces, own.uv, image(0, 2, 2, 3), normals=flat, tangents=along)
    own.save(tmp_path / "m.glb")
    scale, turn = [-2.0, 1.0, 0.5], [0.6, 0.0, 0.0, 0.8]

    def change(tree: dict[str, Any]) -> None:
        tree["nodes"][0] |= {"scale": scale, "rotation": turn}

    found = nr.UVMesh.load(changed(tmp_path / "m.glb", change))
    corners = found.vertices[found.faces.long()]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=-1)[:, None].expand(2, 3, 3)
    first = own.vertices[own.faces.long()]
    side = torch.linalg.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0])[:, 2].sign()
    torch.testing.assert_close(found.normals * side[:, None, None], normal, rtol=0, atol=1e-5)
    torch.testing.assert_close(found.tangents[..., :3], torch.tensor([-1.0, 0, 0]).expand(2, 3, 3), rtol=0, atol=1e-6)
    assert (found.tangents[..., 3] == -1).all()


@pytest.mark.parametrize(
    "broken",
    [
        {"alphaCutoff": "much"},
        {"emissiveFactor": [1, 2]},
        {"pbrMetallicRoughness": [1]},
        {"normalTexture": {"index": 99}},
        {"normalTexture": {"index": 0, "scale": 1e300}},
        {"emissiveTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [float("nan"), 0]}}}},
    ],
)
def test_a_damaged_material_is_an_error_of_its_file(tmp_path: Path, broken: dict[str, Any]) -> None:
    mesh().save(tmp_path / "m.glb")
    with pytest.raises(ValueError, match=r"m\.glb: cannot be read as GLB"):
        nr.UVMesh.load(changed(tmp_path / "m.glb", lambda tree: [one.update(broken) for one in tree["materials"]]))


def test_a_glb_of_ours_has_the_vertices_that_it_was_made_of(tmp_path: Path) -> None:
    """Each face has its own tile, so each corner is a vertex of the file; reading makes them one again, in order."""
    mesh = nr.Mesh.icosphere(2)
    mesh = nr.Mesh(mesh.vertices[torch.randperm(162)], mesh.faces, torch.rand(320, 2, 2, 2, 3))
    mesh.save(tmp_path / "m.glb")
    found = nr.Mesh.load(tmp_path / "m.glb", 2)
    assert torch.equal(found.vertices, mesh.vertices) and torch.equal(found.faces, mesh.faces)
    assert (found.textures - mesh.textures)[:, [0, 0, 1], [0, 1, 0], [1, 0, 0]].abs().max() < 0.51 / 255
    spot = nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    spot.save(tmp_path / "spot.glb")
    assert torch.equal(nr.UVMesh.load(tmp_path / "spot.glb").faces, spot.faces)
    # A file in which the numbers do not fit the places is read as it is.
    data = (tmp_path / "m.glb").read_bytes()
    begin = data.index(mesh.vertices.numpy()[mesh.faces[0]].astype("<f4")[:1].tobytes())
    (tmp_path / "moved.glb").write_bytes(data[:begin] + np.float32(9).tobytes() + data[begin + 4 :])
    assert nr.Mesh.load(tmp_path / "moved.glb", 2).num_vertices == 960


def test_a_file_that_is_named_many_times_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """500 buffers of one file of 8 MB took 4 GB."""
    (tmp_path / "b.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    uris = ["b.bin", "./b.bin", "x/../b.bin", "b.bin"]
    bounds = {"min": [0, 0, 0], "max": [1, 1, 1]}
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": uri, "byteLength": 36} for uri in uris],
        "bufferViews": [{"buffer": number, "byteLength": 36} for number in range(4)],
        "accessors": [{"bufferView": n, "componentType": 5126, "count": 3, "type": "VEC3", **bounds} for n in range(4)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": number}} for number in range(4)]}],
        "nodes": [{"mesh": 0}],
    }
    (tmp_path / "m.gltf").write_text(json.dumps(tree))
    paths: list[str] = []
    monkeypatch.setattr(formats, "read_bytes", lambda path: (paths.append(path.name), path.read_bytes())[1])
    assert nr.UVMesh.load(tmp_path / "m.gltf").num_faces == 4
    assert paths == ["m.gltf", "b.bin"]
