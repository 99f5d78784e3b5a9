"""Stand-ins for modules of mesh generators: each function against its definition, and the order in which they find."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.compare.surfaces import count_holes
from neural_renderer.apps.run.stand_ins import cumesh
from neural_renderer.apps.run.stand_ins.finder import MODULES, generators_stand_in
from neural_renderer.apps.run.stand_ins.grid_sample import grid_sample_3d


def mesh_of(vertices: torch.Tensor, faces: torch.Tensor) -> cumesh.CuMesh:
    mesh = cumesh.CuMesh()
    mesh.init(vertices, faces)
    return mesh


def test_a_linear_volume_is_sampled_exactly() -> None:
    size = 6
    cells = torch.cartesian_prod(*[torch.arange(size)] * 3)
    values = cells.float() @ torch.tensor([[1.0, 0.5], [2.0, 0.0], [3.0, -1.0]])
    coords = torch.cat((torch.zeros(size**3, 1).long(), cells), 1).int()
    order = torch.randperm(size**3)
    points = 0.5 + (size - 1) * torch.rand(1, 50, 3)
    expected = (points - 0.5) @ torch.tensor([[1.0, 0.5], [2.0, 0.0], [3.0, -1.0]])
    shape = torch.Size([1, 2, size, size, size])
    found = grid_sample_3d(values[order], coords[order], shape, points)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)
    nearest = grid_sample_3d(values[order], coords[order], shape, points, mode="nearest")
    torch.testing.assert_close(nearest, points.floor() @ torch.tensor([[1.0, 0.5], [2.0, 0.0], [3.0, -1.0]]))
    alone = grid_sample_3d(torch.ones(1, 2), torch.tensor([[0, 3, 3, 3]]), shape, points)
    near = ((points - 3.5).abs() < 1).all(2)
    assert torch.equal(alone[..., 0] > 0, near) and near.any()  # weights are relative to the voxels that there are
    torch.testing.assert_close(alone[near], torch.ones_like(alone[near]))
    with pytest.raises(ValueError, match="mode: expected trilinear or nearest, got 'cubic'"):
        grid_sample_3d(values, coords, shape, points, mode="cubic")


def test_meshes_are_cleaned() -> None:
    vertices, faces = nr.icosphere(2)
    ball = mesh_of(vertices, torch.cat((faces[1:], faces[7:9].roll(1, 1))))
    ball.remove_duplicate_faces()
    assert ball.num_faces == 319
    ball.fill_holes(max_hole_perimeter=0.1)
    assert count_holes(*ball.read()) > 0
    ball.fill_holes(max_hole_perimeter=10.0)
    closed = ball.read()
    assert count_holes(*closed) == 0 and closed[1].dtype == torch.int32
    turned = closed[1].clone()
    turned[1::2] = turned[1::2].flip(1)
    ball.init(closed[0], turned)
    ball.unify_face_orientations()
    a, b, c = ball.read()[0][ball.read()[1].long()].unbind(1)
    outward = (torch.linalg.cross(b - a, c - a) * a).sum(1)
    assert bool((outward > 0).all()) or bool((outward < 0).all())
    speck = torch.eye(3) * 1e-4 + 5
    ball.init(torch.cat((closed[0], speck)), torch.cat((closed[1], torch.tensor([[0, 1, 2]]) + len(closed[0]))))
    ball.remove_small_connected_components(1e-5)
    assert ball.num_vertices == len(closed[0])
    torch.testing.assert_close(ball.read_vertex_normals(), nr.vertex_normals(*ball.read())[0])
    with pytest.raises(AttributeError, match="CuMesh: expected a method that the export uses, got compute_charts"):
        ball.compute_charts()


def test_fans_are_split_and_closest_points_found() -> None:
    fan = torch.tensor([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 2, 5]])  # three faces at the edge (0, 1)
    mesh = mesh_of(torch.rand(6, 3), fan)
    before = mesh.read()[0][fan]
    mesh.repair_non_manifold_edges()
    vertices, faces = mesh.read()
    assert torch.equal(vertices[faces.long()], before)
    assert len(vertices) == 3 + 3 + 4  # the last face is still connected to the first
    tree = cumesh.cuBVH(*nr.icosphere(2))
    points = torch.nn.functional.normalize(torch.randn(4, 5, 3), dim=2) * 2
    distance, face, weights = tree.unsigned_distance(points, return_uvw=True)
    assert distance.shape == face.shape == (4, 5) and weights.shape == (4, 5, 3)
    assert distance.min() > 0.99 and distance.max() < 1.05
    assert tree.unsigned_distance(points)[2] is None


@pytest.mark.parametrize("closed", [True, False])
def test_the_surface_at_a_distance(closed: bool) -> None:
    vertices, faces = nr.icosphere(3)
    faces = faces if closed else faces[vertices[faces.long()][..., 1].amin(1) > 0]
    cell = 2.5 / 40
    for share in (0.0, 0.75):
        found, triangles = cumesh.remeshing.remesh_narrow_band_dc(
            vertices, faces.int(), torch.zeros(3), 2.5, 40, band=1, project_back=share
        )
        distance = cumesh.cuBVH(vertices, faces).unsigned_distance(found)[0] / cell
        assert (distance - (1 - share)).abs().max() < (0.25 if closed else 0.45)  # nets cut corners
        assert count_holes(found, triangles) == 0 and triangles.dtype == torch.int32
        if share:
            continue
        corners = found[triangles.long()]
        normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        closest = nr.closest_points((vertices, faces), corners.mean(1)).points
        assert (((corners.mean(1) - closest) * normals).sum(1) > 0).all()


def test_a_sphere_is_simplified_and_unwrapped() -> None:
    pytest.importorskip("fast_simplification")
    pytest.importorskip("xatlas")
    mesh = mesh_of(*nr.icosphere(3))
    mesh.simplify(400)
    assert mesh.num_faces <= 400 and count_holes(*mesh.read()) == 0
    vertices, faces, uv, rows = mesh.uv_unwrap(return_vmaps=True)
    assert len(vertices) == len(uv) == len(rows) > mesh.num_vertices and len(faces) == mesh.num_faces
    assert torch.equal(vertices, mesh.read()[0][rows]) and uv.min() >= 0 and uv.max() <= 1
    a, b, c = uv[faces.long()].unbind(1)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).abs().sum() / 2
    assert 0.4 < area < 1  # charts do not overlap


def test_modules_are_found_only_inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "o_voxel").mkdir()
    (tmp_path / "o_voxel" / "__init__.py").write_text("from . import _C\n")
    monkeypatch.syspath_prepend(tmp_path)
    with generators_stand_in():
        from flex_gemm.ops.grid_sample import grid_sample_3d as found  # type: ignore[import-not-found]

        assert found is grid_sample_3d
        assert importlib.import_module("cumesh").CuMesh is cumesh.CuMesh
        with pytest.raises(AttributeError, match=r"cumesh: expected one of .* got LoadObj, which is not here"):
            importlib.import_module("cumesh").LoadObj  # noqa: B018
        with pytest.raises(NotImplementedError, match="hashmap: expected o_voxel to be built"):
            importlib.import_module("o_voxel")._C.hashmap()
    assert not set(MODULES) & set(sys.modules)
    sys.modules.pop("o_voxel")
    own = tmp_path / "cumesh.py"
    own.write_text("CuMesh = 5\n")
    for always, expected in ((False, 5), (True, cumesh.CuMesh)):
        with generators_stand_in(always):
            assert importlib.import_module("cumesh").CuMesh == expected
        sys.modules.pop("cumesh", None)


def test_run_finds_them(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import torch, cumesh\nprint(cumesh.CuMesh().__class__.__module__, torch.zeros(1).cuda().device)\n"
    )
    assert cli.main(["run", "--device", "cpu", str(program)]) == 0
    assert capfd.readouterr().out.split()[-1] == "cpu:0"
