"""`finish`: light meshes that look like heavy ones."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import pytest
import torch
from torch.nn import functional

import neural_renderer as nr
from neural_renderer.apps.command_line import main
from neural_renderer.apps.common.geometry.defects import border_edges
from neural_renderer.apps.common.geometry.edges import area_vectors, areas
from neural_renderer.apps.common.geometry.holes import border_loops
from neural_renderer.apps.finish import command
from neural_renderer.apps.finish.charts import cone_charts, make_charts
from neural_renderer.apps.finish.layout import Layout
from neural_renderer.apps.finish.source import Source, with_materials
from neural_renderer.apps.finish.surface.clean import clean, summary
from neural_renderer.apps.finish.surface.decimate import decimate
from neural_renderer.apps.finish.surface.folds import without_folds
from neural_renderer.apps.finish.surface.parts import reduced
from neural_renderer.apps.finish.surface.silhouettes import Silhouettes
from neural_renderer.io.gltf.container import parsed

CLEAN = {"inside": False, "pieces": 0.01, "holes": 0.1}


def colored(level: int = 4) -> nr.Mesh:
    """A sphere with smooth colours of vertices."""
    vertices, faces = nr.icosphere(level)
    return nr.Mesh(vertices, faces, vertex_colors=0.5 + 0.5 * torch.sin(3 * vertices))


def test_a_light_mesh_looks_like_the_heavy_one() -> None:
    heavy = colored()
    light = nr.finish(heavy, 500, size=256, steps=0)
    assert light.mesh.num_faces == 500
    found = nr.compare(heavy, light.mesh, views=6, size=96, shading="smooth")
    plain = nr.Mesh(light.mesh.vertices, light.mesh.faces)
    assert found.psnr > 29
    assert found.iou > 0.985
    assert found.holes == (0, 0)
    assert nr.compare(heavy, plain, views=6, size=96, shading="smooth").psnr < found.psnr - 10
    assert light.report["border_edges"] == [0, 0]
    assert light.report["charts"]["texels_of_a_face"] > 8


def test_the_normal_map_has_the_shape_of_the_original() -> None:
    heavy = colored(5)
    vertices = heavy.vertices * (1 + 0.01 * torch.sin(25 * heavy.vertices).prod(1, keepdim=True))
    bumpy = nr.Mesh(vertices, heavy.faces, vertex_colors=torch.full_like(vertices, 0.7))
    light = nr.finish(bumpy, 400, size=256, steps=0).mesh
    even = light.replace(materials=(nr.Material(),), material_index=None)
    psnr = [nr.compare(bumpy, mesh, views=4, size=96, shading="smooth").psnr for mesh in (light, even)]
    assert psnr[0] > psnr[1] + 1


def test_improvement_never_makes_held_out_views_worse() -> None:
    found = nr.finish(colored(3), 60, size=64, steps=16, views=6, pixels=64)
    held_out = found.report["held_out"]
    assert held_out["after"]["psnr"] >= held_out["before"]["psnr"]
    assert {"before", "vertices", "images", "after"} <= held_out.keys()
    assert held_out["vertices"]["iou"] > held_out["before"]["iou"] + 0.002


def test_moves_that_fold_faces_are_shortened() -> None:
    vertices, faces = nr.icosphere(1)
    after = 1.1 * vertices
    after[5] = -vertices[5]
    found = without_folds(vertices, after, faces.long())
    turned = (area_vectors(found[faces.long()]) * area_vectors(vertices[faces.long()])).sum(1)
    assert (turned > 0).all()
    near = torch.isin(torch.arange(len(vertices)), faces[(faces == 5).any(1)].long().unique())
    assert torch.equal(found[~near], after[~near])


def test_levels_are_a_list() -> None:
    levels = nr.finish(colored(3), [100, 50], size=64, steps=0)
    assert [level.mesh.num_faces for level in levels] == [100, 50]


def test_levels_in_one_file(tmp_path: Path) -> None:
    levels = [level.mesh for level in nr.finish(colored(3), [50, 200, 100], size=32, steps=0)]
    path = tmp_path / "levels.glb"
    nr.save_levels(path, levels)
    tree, binary = parsed(path.read_bytes())
    assert tree["scenes"] == [{"nodes": [0]}]
    assert tree["extensionsUsed"] == ["MSFT_lod"]
    assert tree["nodes"][0]["extensions"] == {"MSFT_lod": {"ids": [1, 2]}}
    assert [node["mesh"] for node in tree["nodes"]] == [0, 1, 2]
    coverage = tree["nodes"][0]["extras"]["MSFT_screencoverage"]
    assert len(coverage) == 3 and 1 > coverage[0] > coverage[1] > coverage[2] == 0
    assert binary is not None and len(binary) == tree["buffers"][0]["byteLength"]
    ends = [view["byteOffset"] + view["byteLength"] for view in tree["bufferViews"]]
    assert max(ends) <= len(binary) < max(ends) + 4
    assert all(texture["source"] < len(tree["images"]) for texture in tree["textures"])
    counts = [tree["accessors"][mesh["primitives"][0]["indices"]]["count"] for mesh in tree["meshes"]]
    assert counts == [600, 300, 150]
    read = nr.UVMesh.load(path)  # warns of nothing
    assert read.num_faces == 200
    assert nr.compare(read, levels[1], views=2, size=64).psnr > 40
    with pytest.raises(ValueError, match="meshes: expected at least two, got 1"):
        nr.save_levels(path, levels[:1])
    with pytest.raises(ValueError, match=r"path: expected a name that ends in \.glb"):
        nr.save_levels(tmp_path / "levels.obj", levels)


def test_clean_says_what_it_removed() -> None:
    vertices, faces = nr.icosphere(3)
    inner, crumb = 0.5 * vertices, 0.002 * vertices + 3
    count = len(vertices)
    everything = torch.cat((vertices, inner, crumb, torch.full((1, 3), torch.nan)))
    hole = faces[1:]
    twice = faces[5:6].flip(1)
    broken = torch.tensor([[0, 1, 3 * count]])
    equal = torch.tensor([[0, 0, 1]])
    all_faces = torch.cat((hole, faces + count, faces + 2 * count, twice, broken, equal))
    found = clean(everything, all_faces, **CLEAN)
    assert {name: number for name, number in found.removed.items() if number} == {
        "faces with numbers that are not finite": 1,
        "faces with two equal corners": 1,
        "doubled faces": 1,
        "faces of small pieces": len(faces),
        "faces of parts that no view sees": len(faces),
        "holes": 1,
        "faces added in holes": 1,
    }
    assert summary(found.removed)[-1] == "closed 1 holes with 1 faces"
    assert len(found.faces) == len(faces)
    assert not len(border_edges(found.faces.numpy()))
    kept = clean(everything, all_faces, inside=True, pieces=0.0, holes=0.0)
    assert len(kept.faces) == 3 * len(faces) - 1


def test_a_flat_body_is_seen_from_both_sides() -> None:
    vertices, faces = nr.icosphere(2)
    both = torch.cat((vertices, vertices * torch.tensor([1.0, 1.0, 0.0]) + 3))  # a ball, and one pressed flat
    corners = torch.cat((faces, faces + len(vertices)))
    front = {"materials": (nr.Material(double_sided=False),), "material_index": torch.zeros(len(corners)).long()}
    mesh = nr.UVMesh(both, corners, torch.rand(len(corners), 3, 2), torch.ones(4, 4, 3), **front)
    found = nr.finish(mesh, 200, size=64, steps=0).mesh
    is_flat = found.vertices[found.faces.long()].amin((1, 2)) > 1.5
    sides = torch.tensor([material.double_sided for material in found.materials])[found.material_index]
    assert torch.equal(sides, is_flat) and is_flat.any() and not is_flat.all()


def test_vertices_that_a_file_splits_are_joined() -> None:
    vertices, faces = nr.icosphere(3)
    soup = vertices[faces.long()].reshape(-1, 3)
    found = clean(soup, torch.arange(len(soup)).view(-1, 3), **CLEAN)
    assert len(found.vertices) == len(vertices)


@pytest.mark.parametrize("count", [100, 400])
def test_decimation_keeps_closed_surfaces_closed(count: int) -> None:
    vertices, faces = nr.torus()
    less_vertices, less = decimate(vertices, faces.long(), count)
    assert len(less) <= max(1.05 * count, 16)
    assert not len(border_edges(less.numpy()))
    assert int(less.max()) + 1 == len(less_vertices)


def test_silhouettes_decide_between_ways_to_decimate(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = nr.torus()
    silhouettes = Silhouettes(vertices, faces)
    chosen = silhouettes.error(*decimate(vertices, faces.long(), 60))
    monkeypatch.setattr("neural_renderer.apps.finish.surface.decimate._MOST_COMPARED", 0)
    assert chosen < 0.95 * silhouettes.error(*decimate(vertices, faces.long(), 60))


def test_thin_parts_become_fewer_faces_and_stay_closed() -> None:
    vertices, faces = nr.icosphere(1)
    rods = torch.cat([vertices * torch.tensor([1.0, 0.02, 0.02]) + 3 * number for number in range(20)])
    corners = torch.cat([faces.long() + number * len(vertices) for number in range(20)])
    less_vertices, less = decimate(rods, corners, 320)
    assert 300 <= len(less) <= 336
    assert not len(border_edges(less.numpy()))
    assert areas(less_vertices[less]).sum() > 0.9 * areas(rods[corners]).sum()


def test_a_square_keeps_its_border() -> None:
    vertices, faces = nr.icosphere(4)
    half = faces[(vertices[faces.long()][..., 1] > 0).all(1)].long()
    less_vertices, less = decimate(vertices, half, 800)
    border = border_edges(half.numpy())
    assert len(border_edges(less.numpy())) <= len(border)
    rim = less_vertices[torch.from_numpy(border_edges(less.numpy())).flatten().unique()]
    assert torch.cdist(rim, vertices[torch.from_numpy(border).flatten().unique()]).amin(1).max() < 1e-3


@pytest.mark.parametrize("kind", ["xatlas", "cones"])
def test_charts_do_not_overlap(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = nr.icosphere(3)
    if kind == "cones":
        monkeypatch.setattr("neural_renderer.apps.finish.charts.MOST_FACES", 0)
    uv = make_charts(vertices, faces.long(), 256, 2)
    assert uv.min() >= 0
    assert uv.max() <= 1
    area = (uv[:, 1] - uv[:, 0])[:, 0] * (uv[:, 2] - uv[:, 0])[:, 1]
    area = (area - (uv[:, 1] - uv[:, 0])[:, 1] * (uv[:, 2] - uv[:, 0])[:, 0]).abs().sum() / 2 * 256**2
    inside = Layout.of(uv, 256, 0).inside.sum()
    assert abs(float(inside) - float(area)) < 0.02 * float(area) + 32


def test_cone_charts_turn_to_their_faces() -> None:
    vertices, faces = nr.icosphere(3)
    places, corners, _ = cone_charts(vertices, faces.long())
    flat = places[corners]
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    assert ((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) > 0).all()


def test_texels_outside_of_charts_continue_them() -> None:
    uv = torch.tensor([[[0.25, 0.25], [0.75, 0.25], [0.25, 0.75]]])
    layout = Layout.of(uv, 16, 2)
    assert int(layout.inside.sum()) < len(layout.texels)
    places = torch.einsum("nk,nkc->nc", layout.weights, uv[layout.faces])
    centers = torch.stack((layout.texels % 16 + 0.5, 15.5 - layout.texels.div(16, rounding_mode="floor")), 1) / 16
    torch.testing.assert_close(places, centers, rtol=0, atol=1e-5)


def test_materials_are_transferred() -> None:
    vertices, faces = nr.icosphere(3)
    upper = (vertices[faces.long()][..., 1].mean(1) > 0).long()
    metal = nr.Material("metal", metallic=1.0, roughness=0.25)
    glass = nr.Material("glass", opacity=0.5, alpha_mode="BLEND", emissive=(0.0, 0.5, 0.0))
    count = len(faces)
    heavy = nr.UVMesh(
        vertices, faces, torch.zeros(count, 3, 2), torch.full((count,), -1), (), torch.full((count, 3, 3), 0.5), ()
    ).replace(materials=(metal, glass), material_index=upper)
    light = nr.finish(heavy, 300, size=128, steps=0).mesh
    modes = [material.alpha_mode for material in light.materials]
    assert sorted(modes) == ["BLEND", "OPAQUE"]
    up = light.vertices[light.faces.long()][..., 1].mean(1)
    blend = light.material_index == modes.index("BLEND")
    assert (blend[up > 0.1]).all()
    assert not blend[up < -0.1].any()
    texture = light.materials[0].metallic_roughness_texture
    assert texture is not None
    assert 0.25 - 1e-4 <= float(texture.image[..., 1].min()) < 0.26
    assert float(texture.image[..., 2].max()) > 0.99


def test_open_chains_of_edges_are_no_holes() -> None:
    """One of the four edges around a hole has three faces, so that the other three do not close."""
    octahedron = [(2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5), (1, 3, 4), (3, 0, 4)]  # without two neighbours
    tetrahedron = [(0, 2, 6), (2, 0, 7), (0, 6, 7), (2, 7, 6)]
    assert border_loops(torch.tensor(octahedron))[1].tolist() == [0] * 4
    assert not len(border_loops(torch.tensor(octahedron + tetrahedron))[0])


def test_outlines_of_open_parts_are_no_holes() -> None:
    vertices, faces = nr.icosphere(4)
    leaf = torch.tensor([[0.0, 1.2, 0.0], [0.01, 1.2, 0.0], [0.01, 1.21, 0.0], [0.0, 1.21, 0.0]])
    corners = torch.tensor([[0, 1, 2], [0, 2, 3]]) + len(vertices)
    both = torch.cat((vertices, leaf)), torch.cat((faces[1:], corners))
    removed = clean(*both, inside=False, pieces=0.0, holes=0.5).removed
    assert removed["holes"] == 1  # that of the sphere


def test_the_size_of_the_mesh_does_not_matter() -> None:
    vertices, faces = nr.torus()
    unit, tiny = (decimate(scale * vertices, faces.long(), 200) for scale in (1.0, 2.0**-20))
    assert torch.equal(unit[1], tiny[1])
    assert torch.equal(2.0**20 * tiny[0], unit[0])


def test_many_repeats_become_their_mean() -> None:
    vertices, faces = nr.icosphere(3)
    checks = (torch.arange(64)[:, None] + torch.arange(64)) % 2
    uv = 1000 * vertices[faces.long()][..., :2]
    heavy = nr.UVMesh(vertices, faces, uv, checks[..., None].expand(-1, -1, 3).float())
    light = nr.finish(heavy, 200, size=64, steps=0).mesh
    torch.testing.assert_close(light.images[0], torch.full_like(light.images[0], 0.5), rtol=0, atol=0.01)


def test_meshes_without_materials_are_matt_as_their_results() -> None:
    light = nr.finish(colored(2), 320, size=64, steps=0).mesh
    assert [material.roughness.item() for material in Source(colored(2)).drawn.materials] == [1.0]
    both = with_materials(
        light.replace(materials=(nr.Material(metallic=1.0),), material_index=light.material_index - 1)
    )
    assert [material.metallic.item() for material in both.materials] == [1.0, 0.0]
    assert both.material_index is not None and both.material_index.unique().tolist() == [1]


HOSTILE = ["one face", "as many faces", "fan", "all doubled", "mirrored", "cut out"]


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_meshes(kind: str) -> None:
    vertices, faces = nr.icosphere(2)
    heavy: nr.Mesh | nr.UVMesh
    if kind in ("mirrored", "cut out"):
        uv = 0.5 + 0.5 * vertices[faces.long()][..., :2] * (1 if kind == "cut out" else torch.tensor([-1.0, 1.0]))
        picture = (torch.arange(32) / 31)[None, :, None].expand(32, 32, 3)  # bright at u = 1
        material = nr.Material(alpha_mode="MASK", opacity_texture=nr.Texture((picture[..., :1] > 0.5).float()))
        heavy = nr.UVMesh(vertices, faces, uv, picture.contiguous(), wrap="clamp")
        if kind == "cut out":
            heavy = heavy.replace(materials=(material,), material_index=torch.zeros(len(faces), dtype=torch.int64))
    else:
        if kind == "one face":
            faces = faces[:1]
        elif kind == "fan":
            faces = torch.tensor([[0, 1, number] for number in range(2, 30)])
        elif kind == "all doubled":
            faces = torch.cat((faces, faces.flip(1)))
        heavy = nr.Mesh(vertices, faces)
    light = nr.finish(heavy, 330, size=64, steps=0).mesh
    assert 0 < light.num_faces <= 330
    assert torch.isfinite(light.images[0]).all() and torch.isfinite(light.vertices).all()
    if isinstance(heavy, nr.UVMesh):
        found = nr.compare(heavy, light, views=4, size=64, layers=2 if kind == "cut out" else None)
        assert found.psnr > 25
        assert found.iou > 0.97


def test_loose_triangles_grow_as_they_become_fewer() -> None:
    vertices, faces = nr.icosphere(4)
    soup = (vertices[faces.long()] + 0.1 * torch.rand(len(faces), 1, 3)).reshape(-1, 3)
    heavy = nr.Mesh(soup, torch.arange(len(soup)).view(-1, 3), vertex_colors=0.5 + 0.5 * torch.sin(3 * soup))
    light = nr.finish(heavy, 500, size=128, steps=0, keep_inside=True)
    assert 490 <= light.mesh.num_faces <= 500
    assert light.report["area"] == pytest.approx(1, abs=0.02)
    found = nr.compare(heavy, light.mesh, views=4, size=64, shading="pbr")
    assert found.iou > 0.78
    trunk, bark = nr.icosphere(3)
    both = torch.cat((soup, trunk * 3)), torch.cat((torch.arange(len(soup)).view(-1, 3), bark + len(soup)))
    mixed = reduced(*both, 600)
    assert len(mixed.faces) < 620
    assert not (mixed.moved - mixed.vertices)[
        : int((mixed.moved.norm(dim=1) > 2.9).sum())
    ].any()  # the large part stays


def test_small_balls_stay_closed_as_they_become_fewer() -> None:
    vertices, faces = nr.icosphere(1)
    places = torch.stack(torch.meshgrid(*[torch.arange(8.0)] * 3, indexing="ij"), -1).reshape(-1, 1, 3)
    balls = (0.4 * vertices + places).reshape(-1, 3)
    corners = (faces.long() + len(vertices) * torch.arange(len(places))[:, None, None]).reshape(-1, 3)
    few = reduced(balls, corners, 800)
    assert 780 <= len(few.faces) <= 820
    assert not len(border_edges(few.faces.numpy()))
    assert float(areas(few.moved[few.faces]).sum() / areas(balls[corners]).sum()) == pytest.approx(1, abs=0.01)
    with_larger = reduced(
        torch.cat((balls, 0.88 * vertices + 20)), torch.cat((corners, faces.long() + len(balls))), 800
    )
    larger = with_larger.vertices.amin(1) > 15
    assert larger.any() and (with_larger.moved == with_larger.vertices)[larger].all()  # it is not enlarged


def tube(mirrored: bool = False, columns: int = 48, rows: int = 16) -> nr.UVMesh:
    """A vase whose image goes round it once, or to and fro, of two materials, with a map of normals."""
    u, v = torch.meshgrid(torch.linspace(0, 1, columns + 1), torch.linspace(0, 1, rows + 1), indexing="ij")
    angle, radius = 2 * torch.pi * u, 1 + 0.3 * torch.sin(3 * v)
    vertices = torch.stack((radius * torch.cos(angle), 3 * v, radius * torch.sin(angle)), -1).reshape(-1, 3)
    corner = (torch.arange(columns)[:, None] * (rows + 1) + torch.arange(rows)).reshape(-1, 1)
    step = rows + 1
    faces = torch.cat((corner + torch.tensor([0, 1, step]), corner + torch.tensor([1, step + 1, step])))
    around = 1 - (2 * u - 1).abs() if mirrored else u
    uv = torch.stack((around, v), -1).reshape(-1, 2)[faces]
    image = torch.rand(8, 16, 3).repeat_interleave(16, 0).repeat_interleave(16, 1)
    bumps = nr.Texture(torch.tensor([0.5, 0.5, 1.0]).expand(4, 4, 3).contiguous())
    materials = nr.Material("clay", normal_texture=bumps), nr.Material("gold", metallic=1.0)
    index = (v.reshape(-1)[faces].mean(1) > 0.5).long()
    return nr.UVMesh(vertices, faces, uv, image).replace(materials=materials, material_index=index)


@pytest.mark.parametrize("mirrored", [False, True])
def test_charts_and_images_can_be_kept(mirrored: bool) -> None:
    pytest.importorskip("opengl_decimate")
    heavy = tube(mirrored)
    light = nr.finish(heavy, 300, keep_uv=True, steps=3, views=4, pixels=64)
    mesh = light.mesh
    assert 290 <= mesh.num_faces <= 300
    assert torch.equal(mesh.images[0], heavy.images[0])
    assert [material.name for material in mesh.materials] == ["clay", "gold"]
    middle = mesh.vertices[mesh.faces.long()][..., 1].mean(1)
    assert torch.equal(mesh.material_index, (middle > 1.5).long())
    assert nr.compare(heavy, mesh, views=4, size=96, shading="pbr").psnr > 26.5
    places = mesh.vertices[mesh.faces.long()].detach()
    angle = torch.atan2(places[..., 2], places[..., 0]) / (2 * torch.pi) % 1
    expected = 1 - (2 * angle - 1).abs() if mirrored else angle
    error = (mesh.uv[..., 0] - expected).abs()
    assert (error if mirrored else torch.minimum(error, 1 - error)).max() < 0.02
    assert (mesh.uv[..., 0].amax(1) - mesh.uv[..., 0].amin(1)).max() < 0.5  # no face spans the seam
    radial = functional.normalize(places * torch.tensor([1.0, 0.0, 1.0]), dim=-1)
    assert ((mesh.normals * radial).sum(-1).abs() > 0.8).all()
    assert mesh.tangents is not None and ((mesh.tangents[..., :3] * mesh.normals).sum(-1).abs() < 1e-4).all()
    assert light.report["charts"]["texels_of_a_face"] > 8
    assert {"before", "vertices", "after"} <= light.report["held_out"].keys()
    assert nr.finish(heavy, 5000, size=64, keep_uv=True, steps=0).mesh.images[0].shape == (32, 64, 3)


def test_materials_of_flat_parts_keep_their_borders() -> None:
    pytest.importorskip("opengl_decimate")
    places = torch.linspace(-1, 1, 33)
    vertices = torch.stack((*torch.meshgrid(places, places, indexing="ij"), torch.zeros(33, 33)), -1).view(-1, 3)
    corner = (torch.arange(32)[:, None] * 33 + torch.arange(32)).view(-1, 1)
    faces = torch.cat((corner + torch.tensor([0, 33, 1]), corner + torch.tensor([33, 34, 1])))
    window = (vertices[faces].mean(1).norm(dim=1) < 0.5).long()  # with a ragged border
    plate = nr.UVMesh(vertices, faces, vertices[faces][..., :2] / 2 + 0.5, torch.ones(4, 4, 3))
    plate = plate.replace(materials=(nr.Material("wall"), nr.Material("glass")), material_index=window)
    light = nr.finish(plate, 700, keep_uv=True, steps=0).mesh
    sizes = [areas(mesh.vertices[mesh.faces.long()])[mesh.material_index == 1].sum().item() for mesh in (plate, light)]
    assert light.num_faces <= 700
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-5)


def test_charts_to_keep_are_needed() -> None:
    sentence = "keep_uv: expected a mesh with texture coordinates and an image, got one without"
    with pytest.raises(ValueError, match=sentence):
        nr.finish(colored(1), 20, keep_uv=True)
    with pytest.raises(ValueError, match=sentence):
        nr.finish(Source(colored(1)).mesh, 20, keep_uv=True)


def test_open_walls_and_rods_keep_their_borders() -> None:
    u, v = torch.meshgrid(torch.linspace(0, 1, 9), torch.linspace(0, 1, 9), indexing="ij")
    wall = torch.stack((u, v, torch.zeros_like(u)), -1).reshape(-1, 3)
    corner = (torch.arange(8)[:, None] * 9 + torch.arange(8)).reshape(-1, 1)
    faces = torch.cat((corner + torch.tensor([0, 1, 9]), corner + torch.tensor([1, 10, 9])))
    rods = [wall * torch.tensor([0.002, 0.9, 1.0]) + torch.tensor([0.05 * row, 0.05, 0.1]) for row in range(1, 20)]
    surface = torch.cat((wall, *rods)), torch.cat([faces + number * len(wall) for number in range(20)])
    found = reduced(*surface, 200)
    assert found.moved is found.vertices  # no part is left out or enlarged
    assert len(found.faces) <= 210
    for low, high in ((surface[0].amin(0), found.vertices.amin(0)), (surface[0].amax(0), found.vertices.amax(0))):
        torch.testing.assert_close(low, high, rtol=0, atol=1e-4)
    area = area_vectors(found.vertices[found.faces]).norm(dim=1).sum() / 2
    assert float(area) == pytest.approx(1 + 19 * 0.0018, rel=1e-3)


def test_walls_that_cross_stay_whole() -> None:
    size, walls, numbers = 16, (2, 6, 10, 14), {}

    def corner(*place: int) -> int:
        return numbers.setdefault(place, len(numbers))

    faces = []
    for wall, along, up in itertools.product(walls, range(size), range(4)):
        ends = (along, up), (along + 1, up), (along + 1, up + 1), (along, up + 1)
        for places in ([(wall, *end) for end in ends], [(end[0], wall, end[1]) for end in ends]):
            a, b, c, d = (corner(*place) for place in places)
            faces += [[a, b, c], [a, c, d]]
    vertices = torch.tensor(list(numbers)).float()
    less_vertices, less = decimate(vertices, torch.tensor(faces), 240)
    assert len(less) <= 240
    assert areas(less_vertices[less]).sum() == pytest.approx(8 * 4 * size, rel=1e-4)
    for low, high in ((vertices.amin(0), less_vertices.amin(0)), (vertices.amax(0), less_vertices.amax(0))):
        torch.testing.assert_close(low, high, rtol=0, atol=1e-3)


def test_nothing_that_can_be_kept_is_an_error() -> None:
    vertices = torch.full((3, 3), torch.nan)
    with pytest.raises(ValueError, match="expected at least one face"):
        clean(vertices, torch.tensor([[0, 1, 2]]), **CLEAN)
    line = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="mesh: expected a face with an area, got vertices in a line"):
        clean(line, torch.tensor([[0, 1, 2]]), **CLEAN)
    with pytest.raises(ValueError, match=r"got none; its longest side is 1e\+12"):
        clean(torch.cat((line, torch.full((1, 3), 1e12))), torch.tensor([[0, 1, 2]] * 3 + [[0, 1, 3]]), **CLEAN)
    with pytest.raises(ValueError, match="faces: expected at least 4, got 3"):
        nr.finish(colored(1), 3)


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "_SHEET_VIEWS", 2)
    monkeypatch.setattr(command, "_SHEET_SIZE", 64)
    source, target = tmp_path / "ball.ply", tmp_path / "small.glb"
    colored(2).save(source)
    line = ["finish", str(source), "-o", str(target), "--faces", "100", "60", "--size", "64", "--pixels", "64", "--lod"]
    assert main([*line, "--steps", "1", "--views", "4"]) == 0
    report = json.loads((tmp_path / "small" / "report.json").read_text())
    for count in (100, 60):
        mesh = nr.UVMesh.load(tmp_path / f"small_{count}.glb")
        assert mesh.num_faces == count
        assert (tmp_path / "small" / str(count) / "sheet.png").is_file()
        assert report["levels"][str(count)]["faces"] == count
    assert report["finished"]
    assert nr.UVMesh.load(target).num_faces == 100
    assert main([*line, "--steps", "1", "--views", "4"]) == 1  # there are results
    assert main([*line, "--steps", "3", "--views", "4", "--force", "--resume"]) == 1  # of other steps
    assert main([*line, "--steps", "1", "--views", "4", "--force", "--resume"]) == 0


def test_outputs_that_are_no_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    colored(1).save(tmp_path / "ball.ply")
    for name, more, sentence in (
        ("small.stl", [], "--output: expected a name that ends in .glb or .obj, or a folder, got 'small.stl'"),
        ("small.obj", ["--faces", "20", "10", "--lod"], "--lod: expected several --faces and an output"),
        ("small.glb", ["--lod"], "--lod: expected several --faces and an output"),
    ):
        assert main(["finish", str(tmp_path / "ball.ply"), "-o", str(tmp_path / name), *more]) == 1
        assert sentence in " ".join(capsys.readouterr().err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["ball.ply"]


@pytest.mark.slow
def test_batch(tmp_path: Path) -> None:
    colored(2).save(tmp_path / "ball.ply")
    (tmp_path / "table.csv").write_text("mesh,faces,size,steps\nball.ply,40,64,0\n")
    assert main(["batch", "finish", str(tmp_path / "table.csv"), "-o", str(tmp_path / "out"), "-j", "0"]) == 0
    assert nr.UVMesh.load(tmp_path / "out" / "ball" / "mesh.glb").num_faces == 40
    assert (tmp_path / "out" / "sheet.png").is_file()
