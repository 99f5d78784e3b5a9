"""`compare`: numbers that are known for simple meshes, limits, and meshes that are not as expected."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.compare.stage import Stage, sphere_points
from neural_renderer.apps.compare.structure import multi_scale_similarity
from neural_renderer.apps.compare.surfaces import count_holes, surface_distance

FEW = {"views": 3, "size": 48, "samples": 300}
BALL = nr.Mesh.icosphere(3)


def plain(color: float, mesh: nr.Mesh = BALL) -> nr.Mesh:
    return nr.Mesh(mesh.vertices, mesh.faces, face_colors=torch.full((len(mesh.faces), 3), color))


def test_a_mesh_is_equal_to_itself() -> None:
    found = nr.compare(BALL, BALL, **FEW)
    assert found.psnr == math.inf and found.iou == 1 and found.normal_angle == 0
    assert found.distance < 1e-6 and found.holes == (0, 0) and found.faces == (1280, 1280)
    assert found.table()[0].endswith("equal pictures")
    assert found.failures(psnr=100, iou=1, angle=0, distance=1e-6, new_holes=0) == []
    assert json.loads(json.dumps(found.as_dict()))["psnr"] is None


def test_psnr_is_that_of_the_covered_pixels() -> None:
    """Without light, grey 0.5 and 0.6 differ by 0.1 in each covered pixel, whatever the size of the silhouette."""
    small = nr.Mesh(BALL.vertices * 0.5, BALL.faces)
    for mesh in (BALL, small):
        stage = Stage.around(BALL, 3, 48, light=None)
        errors = stage.errors(plain(0.5, mesh), plain(0.6, mesh))
        # Pixels at the outline are partly white in both.
        assert 20 <= errors.psnr < 20.6 and errors.iou == 1
        assert errors.psnrs.shape == (3,)


def test_silhouettes_and_distances_of_two_balls() -> None:
    outer, inner = BALL, nr.Mesh(BALL.vertices * 0.8, BALL.faces)
    found = nr.compare(outer, inner, views=3, size=128, samples=300)
    sine = math.sin(math.radians(20)) / 1.05  # of half the angle that shows the outer ball
    shown = [math.tan(math.asin(radius * sine)) for radius in (0.8, 1.0)]
    assert found.iou == pytest.approx((shown[0] / shown[1]) ** 2, abs=0.005)
    assert found.distance == pytest.approx(0.2 / 2, rel=0.02)  # of the diameter
    assert found.largest_distance >= found.distance
    assert found.normal_angle is not None and found.normal_angle > 5
    shifted = (outer.vertices + torch.tensor([10.0, 0, 0]), outer.faces)
    mean, largest = surface_distance((outer.vertices, outer.faces), shifted, 500)
    assert 9 <= mean <= 9.5 < largest <= 10.01


def test_holes() -> None:
    vertices, faces = nr.cube()
    assert count_holes(vertices, faces) == 0
    assert count_holes(vertices[faces.long()].reshape(-1, 3), torch.arange(36).reshape(12, 3)) == 0
    ball = BALL.faces
    assert count_holes(BALL.vertices, torch.cat((ball[1:500], ball[501:]))) == 2
    assert count_holes(torch.eye(3), torch.tensor([[0, 1, 2]])) == 1
    assert count_holes(torch.eye(3), torch.tensor([[0, 1, 1]])) == 0


def test_views_are_even_over_the_sphere() -> None:
    points = sphere_points(24)
    torch.testing.assert_close(points.norm(dim=1), torch.ones(24, dtype=torch.float64))
    assert points.mean(0).norm() < 0.02
    angles = torch.rad2deg((points @ points.T - 2 * torch.eye(24)).amax(1).acos())
    assert angles.min() > 25  # 24 circles of this radius, packed as well as possible, are 43.7° apart


def test_textures_count_and_the_worst_view_comes_first(tmp_path: Path) -> None:
    mesh = nr.UVMesh.load("examples/data/spot.obj")
    other = mesh.resized(64)
    found = nr.compare(mesh, other, **FEW, output=tmp_path / "sheet.png")
    assert found.texels == (1024**2, 64**2) and found.worst_psnr < found.psnr < 30
    picture = nr.load_image(tmp_path / "sheet.png")
    assert picture.shape[1] == 3 * 48 and picture.shape[0] > 3 * 48
    first, second, difference = picture[: 3 * 48].split(48)
    assert (first - second).abs().sum() > 0
    sums = [part.sum() for part in difference[24:].split(48, 1)]  # below the label
    assert sums[0] > 0
    stage = Stage.around(mesh, 3, 48)
    assert stage.errors(mesh, other).worst_view in range(3)


def test_given_cameras_and_materials() -> None:
    camera = nr.Camera.look_at((0.0, 0.0, 3.0), viewing_angle=30)
    found = nr.compare(BALL, (BALL.vertices, BALL.faces), cameras=camera, size=(32, 48), samples=100)
    assert found.views == 1 and found.size == (32, 48)
    mesh = nr.UVMesh.load("examples/data/spot.obj")
    found = nr.compare(mesh, mesh, views=1, size=32, shading="pbr", layers=2, samples=100)
    assert found.psnr == math.inf and found.normal_angle == 0


@pytest.mark.parametrize(
    ("second", "sentence"),
    [
        (None, "second: expected a mesh or the path of one, got NoneType"),
        ("nothing.obj", "nothing.obj: expected a file, got nothing there"),
        (torch.zeros(3), "second: expected a mesh"),
    ],
)
def test_what_is_no_mesh(second: object, sentence: str) -> None:
    with pytest.raises((OSError, TypeError, ValueError), match=sentence):
        nr.compare(BALL, second)
    with pytest.raises(TypeError, match="cameras: expected a Camera, got int"):
        nr.compare(BALL, BALL, cameras=3, samples=1)


def test_strange_meshes() -> None:
    triangle = (torch.eye(3), torch.tensor([[0, 1, 2]]))
    found = nr.compare(triangle, triangle, **FEW)
    assert found.psnr == math.inf and found.holes == (1, 1)
    huge = (BALL.vertices * 1000, BALL.faces)  # the cameras are inside of it
    found = nr.compare(BALL, huge, **FEW)
    assert found.distance > 100 and found.iou < 1
    found = nr.compare(huge, BALL, **FEW)  # smaller than a pixel
    assert found.iou < 0.01 and found.normal_angle is None
    assert found.failures(angle=90) == ["angle: expected at most 90 degrees, got no pixel that shows both meshes"]
    flat = (torch.eye(3)[[0, 1, 1]], torch.tensor([[0, 1, 2]]))
    for scale in (1e-30, 1e30):
        with pytest.raises(ValueError, match=r"mesh: expected a longest side from 1e-15 to 1e\+15 units, got 2e"):
            nr.compare(ball := nr.Mesh.icosphere(0), nr.Mesh(ball.vertices * scale, ball.faces), views=1, size=32)
    with pytest.raises(ValueError, match="expected a surface with an area"):
        nr.compare(BALL, flat)
    with pytest.raises(ValueError, match="second: expected finite"):
        nr.compare(BALL, nr.UVMesh(BALL.vertices * math.nan, BALL.faces, torch.zeros(1280, 3, 2), torch.ones(2, 2, 3)))


def test_the_command_keeps_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = tmp_path / "a.obj", tmp_path / "b.ply"
    BALL.save(a)
    nr.Mesh.icosphere(1).save(b)
    small = ["--views", "2", "--size", "32", "--samples", "100"]
    assert cli.main(["compare", str(a), str(b), *small, "--json", "--iou", "0.5"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["faces"] == [1280, 80] and numbers["views"] == 2
    sheet = tmp_path / "sheet.png"
    line = ["compare", str(a), str(b), *small, "-o", str(sheet), "--psnr", "90", "--angle", "0", "--new-holes", "0"]
    assert cli.main(line) == 1
    said = capsys.readouterr()
    assert said.out.splitlines()[0].startswith("PSNR") and said.out.splitlines()[-1] == str(sheet) and sheet.exists()
    [first, second] = said.err.splitlines()
    assert first.startswith("--psnr: expected at least 90 dB, got")
    assert second.startswith("--angle: expected at most 0 degrees, got")


def test_the_command_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "text.glb"
    text.write_text("no mesh")
    empty = tmp_path / "empty.obj"
    empty.write_text("v 0 0 0\n")
    ball = tmp_path / "ball.obj"
    BALL.save(ball)
    for second, limits, sentence in (
        (text, [], "text.glb: cannot be read as GLB"),
        (empty, [], "empty.obj"),
        (ball, ["--iou", "2"], "--iou: expected a number from 0 to 1"),
        (ball, ["--psnr", "0"], "--psnr: expected a number above 0"),
        (ball, ["--views", "0"], "--views: expected at least 1"),
        (ball, ["-o", "sheet.gif"], "--output: expected a name that ends in .png"),
        (ball, ["-o", str(ball.with_suffix(".jpg") / "a.png")], "--output"),
    ):
        ball.with_suffix(".jpg").touch()
        assert cli.main(["compare", str(ball), str(second), *limits]) == 1
        assert sentence in capsys.readouterr().err


def test_structural_similarity() -> None:
    torch.manual_seed(0)
    picture = torch.rand(1, 3, 48, 48).repeat_interleave(4, 2).repeat_interleave(4, 3)
    shown = torch.ones(1, 192, 192, dtype=torch.bool)
    noisy = (picture + 0.2 * torch.randn(picture.shape)).clamp(0, 1)
    brighter = 0.2 + 0.8 * picture
    values = [multi_scale_similarity(picture, other, shown).item() for other in (picture, brighter, noisy, 1 - picture)]
    assert values[0] == pytest.approx(1, abs=1e-9)
    assert 1 > values[1] > values[2] > values[3] >= 0
    assert multi_scale_similarity(picture, noisy, torch.zeros_like(shown)).item() == 1
    half = shown.clone()
    half[..., 96:] = False
    mixed = torch.cat((picture[..., :96], noisy[..., 96:]), 3)
    hidden, whole = (multi_scale_similarity(picture, mixed, each).item() for each in (half, shown))
    assert 1 > hidden > whole
    assert math.isnan(multi_scale_similarity(picture[..., :8], noisy[..., :8], shown[..., :8]).item())
    found = nr.compare(BALL, nr.Mesh.icosphere(1), views=2, size=64, samples=100)
    assert found.ms_ssim is not None and 0.3 < found.ms_ssim < 1
    assert found.failures(ms_ssim=0.9999)[0].startswith("ms_ssim: expected at least 0.9999, got 0.")
