"""Materials of MTL files: read from text, and written and read again."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

import neural_renderer as nr

OBJ = """mtllib m.mtl
v 0 0 0
v 1 0 0
v 0 1 0
vt 0 0
vt 1 0
vt 0 1
vn 0 0 2
vn 0 3 0
usemtl shiny
f 1/1/1 2/2/2 3/3/-2
usemtl plain
f 1/1 3/3 2/2
"""


def image(seed: int, *shape: int) -> Tensor:
    """Pixels that a PNG keeps exactly."""
    return torch.randint(0, 256, shape, generator=torch.Generator().manual_seed(seed)).float() / 255


def load(folder: Path, mtl: str) -> nr.UVMesh:
    (folder / "m.obj").write_text(OBJ)
    (folder / "m.mtl").write_text(f"newmtl shiny\n{mtl}\nnewmtl plain\nKd 0.5 0.25 1\n")
    return nr.UVMesh.load(folder / "m.obj")


def test_statements(tmp_path: Path) -> None:
    mesh = load(tmp_path, "Kd 1 0 0\nKs 0.5 0.25 0\nNs 64\nd 0.25\nKe 2 0 0\nPm 0.5\nPr 0.125")
    shiny, plain = mesh.materials
    assert (shiny.name, shiny.alpha_mode, plain.alpha_mode) == ("shiny", "BLEND", "OPAQUE")
    numbers = shiny.opacity, shiny.shininess, shiny.metallic, shiny.roughness
    assert [float(number) for number in numbers] == [0.25, 64, 0.5, 0.125]
    assert shiny.specular.tolist() == [0.5, 0.25, 0] and shiny.emissive.tolist() == [2, 0, 0]
    assert mesh.material_index.tolist() == [0, 1] and mesh.colors[:, 0].tolist() == [[1, 0, 0], [0.5, 0.25, 1]]
    # Negative indices count from the end; a face without normals has zeros.
    assert mesh.normals.tolist() == [[[0, 0, 1], [0, 1, 0], [0, 0, 1]], [[0, 0, 0]] * 3]
    assert load(tmp_path, "Tr 0.75").materials[0].opacity == 0.25


@pytest.mark.parametrize("line", ["Ks a b c", "Ns nan", "Ns", "d -halo x", "Tr 1e999", "Ke 1e99 0 0", "Pm", "vn x"])
def test_what_is_no_number_is_ignored(tmp_path: Path, line: str) -> None:
    shiny = load(tmp_path, f"Kd 1 0 0\n{line}").materials[0]
    assert shiny.opacity == 1 and not shiny.specular.any() and not shiny.emissive.any() and shiny.shininess == 10


def test_images(tmp_path: Path) -> None:
    """Alpha of an image with transparency, brightness of another; heights become normals, normals stay."""
    color, heights = image(0, 4, 4, 3), image(1, 4, 4)
    nr.save_image(tmp_path / "color.png", color)
    nr.save_image(tmp_path / "heights.png", heights)
    nr.save_image(tmp_path / "clear.png", torch.cat((color, heights[..., None]), -1))
    maps = "map_Kd -s 2 1 -o 0.5 0 color.png\nmap_Ks -clamp on -s 2 1 -o 0.5 0 color.png\nmap_d clear.png\n"
    mesh = load(tmp_path, maps + "map_Bump -bm 2 -s 2 4 heights.png\n")
    shiny = mesh.materials[0]
    torch.testing.assert_close(shiny.specular_texture.image, color)
    torch.testing.assert_close(shiny.opacity_texture.image[..., 0], heights)
    assert shiny.specular.tolist() == [1, 1, 1] and shiny.alpha_mode == "BLEND"
    # All textures lie where the statements put them, though the mesh's coordinates have the transform of map_Kd.
    raw = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    places = mesh.uv[0]
    torch.testing.assert_close(places, raw * torch.tensor([2.0, 1.0]) + torch.tensor([0.5, 0.0]))
    torch.testing.assert_close(shiny.specular_texture.transformed(places), places)
    torch.testing.assert_close(shiny.opacity_texture.transformed(places), raw)
    torch.testing.assert_close(shiny.normal_texture.transformed(places), raw * torch.tensor([2.0, 4.0]))
    assert shiny.specular_texture.wrap == "clamp" and shiny.normal_texture.wrap == "repeat"
    normals = 2 * shiny.normal_texture.image - 1
    slope = (heights.roll(-1, 1) - heights.roll(1, 1)) / 2 * 2
    torch.testing.assert_close(-normals[..., 0] / normals[..., 2], slope, rtol=0, atol=1e-5)
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(4, 4))

    other = load(tmp_path, "norm -bm 0.5 color.png\nmap_Pr heights.png").materials[0]
    torch.testing.assert_close(other.normal_texture.image, color)
    assert other.normal_scale == 0.5 and other.roughness == 1
    torch.testing.assert_close(other.metallic_roughness_texture.image[..., 1], heights)


def test_a_saved_material_comes_back(tmp_path: Path) -> None:
    mesh = load(tmp_path, "Kd 1 0 0")
    packed = image(2, 4, 8, 3)
    glass = nr.Material(
        "glass",
        opacity=0.5,
        opacity_texture=nr.Texture(image(3, 2, 2, 1)),
        alpha_mode="BLEND",
        metallic=0.5,
        roughness=0.25,
        metallic_roughness_texture=nr.Texture(packed),
        emissive=(0.5, 0.25, 0.0),
        specular=(0.5, 0.5, 0.25),
        specular_texture=nr.Texture(image(4, 4, 4, 3), wrap="clamp", offset=(0.25, 0.5), scale=(2.0, 3.0)),
        shininess=32.0,
        normal_texture=nr.Texture(image(5, 4, 4, 3)),
        normal_scale=0.5,
    )
    vertices, faces = mesh.vertices, mesh.faces
    first = nr.UVMesh(vertices, faces, mesh.uv, image(6, 8, 8, 3), materials=(glass,), normals=mesh.normals)
    first.save(tmp_path / "new.obj")
    again = nr.UVMesh.load(tmp_path / "new.obj")
    (found,) = again.materials
    assert (found.name, found.alpha_mode) == ("glass", "BLEND")
    for name in ("opacity", "metallic", "roughness", "emissive", "specular", "shininess", "normal_scale"):
        assert torch.equal(getattr(found, name), getattr(glass, name)), name
    for name, texture in glass.textures().items():
        kept, known = getattr(found, name).image, texture.image
        if name == "metallic_roughness_texture":  # red is not kept
            kept, known = kept[..., 1:], known[..., 1:]
        torch.testing.assert_close(kept, known, rtol=0, atol=1e-6)
    moved = found.specular_texture
    assert (moved.wrap, moved.offset.tolist(), moved.scale.tolist()) == ("clamp", [0.25, 0.5], [2, 3])
    shown = nr.fill_gutters(first.images[0], first.uv)
    torch.testing.assert_close(again.images[0], shown, rtol=0, atol=1e-6)
    torch.testing.assert_close(again.normals, first.normals, rtol=0, atol=1e-6)
    torch.testing.assert_close(again.uv, first.uv)
    first.save(tmp_path / "new.obj")  # its own files are replaced


def test_faces_of_one_colour_need_no_image(tmp_path: Path) -> None:
    mesh = load(tmp_path, "Kd 1 0 0")
    mesh.save(tmp_path / "new.obj")
    assert not list(tmp_path.glob("new*.png"))
    torch.testing.assert_close(nr.UVMesh.load(tmp_path / "new.obj").colors, mesh.colors, rtol=0, atol=1e-7)
