"""The command `pose`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli


@pytest.fixture()
def folder(tmp_path: Path) -> Path:
    """A lopsided box and three pictures of it: the second differs by a small turn, the third by a large one."""
    vertices, faces = nr.cube()
    mesh = nr.Mesh(vertices * torch.tensor([1.0, 0.6, 0.3]) * (1 + 0.5 * (vertices[:, :1] > 0)), faces)
    mesh.save(tmp_path / "box.obj")
    (tmp_path / "frames").mkdir()
    for number, azimuth in enumerate((30.0, 36.0, 130.0)):
        camera = nr.Camera.look_at(nr.get_points_from_angles(6.0, 25.0, azimuth), viewing_angle=18.0)
        nr.save_image(tmp_path / "frames" / f"{number}.png", nr.render(mesh, camera, 64, outputs=("alpha",)).alpha[0])
    return tmp_path


def test_a_film(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "out"
    arguments = ["pose", str(folder / "box.obj"), str(folder / "frames"), "-o", str(out), "--no-photos"]
    assert cli.main([*arguments, "--viewing-angle", "18"]) == 0
    said = capsys.readouterr().out
    assert "0.png: " in said and "1.png: " in said
    report = json.loads((out / "report.json").read_text())
    assert [row["agreement"] > 0.97 for row in report["poses"]] == [True] * 3  # lost and found again
    assert len(report["poses"][0]["covariance"]) == 6
    assert len(nr.Camera.load(out / "cameras.json")) == 3
    shown = nr.load_image(out / "overlay.png")
    assert shown.shape == (201, 201, 3)
    assert (shown[:, 64:67] - 0.6).abs().max() < 0.01 and (shown[64:67] - 0.6).abs().max() < 0.01  # gaps
    drawn = shown[:64, 67:131]  # a white box on white, with an outline
    assert 0.01 < ((drawn - 0.6).abs().amax(2) < 0.01).float().mean() < 0.2
    drawn = ["render", str(folder / "box.obj"), "-o", str(folder / "a.png"), "--camera", str(out / "report.json")]
    assert cli.main([*drawn, "--size", "64", "--mode", "silhouettes"]) == 0
    again, given = (nr.load_image(path)[..., 0] for path in (folder / "a.png", folder / "frames" / "0.png"))
    assert float(nr.metrics.silhouette_iou(again[None], given[None])) > 0.97
    assert cli.main(arguments) == 1
    assert "--force replaces it" in capsys.readouterr().err


def test_options_that_do_not_fit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = str(folder / "frames" / "0.png")
    start = ["pose", str(folder / "box.obj"), image, "-o", str(folder / "out")]
    (folder / "empty").mkdir()
    for options, message in (
        (["--viewing-angle", "90"], "--viewing-angle: expected a number above 0.0 and below 90.0"),
        (["--masks", str(folder / "empty")], "expected a mask 0.png, got none"),
        (["--depth", str(folder / "empty")], "expected depth 0.png or 0.npy, got none"),
        (["--size", "4"], "--size: expected at least 16"),
    ):
        assert cli.main([*start, *options]) == 1
        assert message in capsys.readouterr().err
    for flag in ("--hidden", "--fit-focal", "--view"):
        assert cli.main([*start, "--rig", flag]) == 1
        assert f"{flag}: expected none with --rig, got both" in capsys.readouterr().err
    camera = folder / "camera.json"
    nr.Camera.look_at((0.0, 0.0, 3.0)).save(camera)
    assert cli.main([*start, "--rig", "--camera", str(camera)]) == 1
    assert "MESH: expected a file that ends in .glb or .gltf with --rig, got 'box.obj'" in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_pictures_that_do_not_fit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No picture at all; clutter, where `pose` has no --box to offer; and a folder of files that are no pictures."""
    start, end = ["pose", str(folder / "box.obj")], ["-o", str(folder / "out")]
    clutter = torch.rand(3, 32, 32, generator=torch.Generator().manual_seed(0))
    nr.save_image(folder / "clutter.png", clutter)
    (folder / "notes").mkdir()
    (folder / "notes" / "a.txt").write_text("a")
    for images, message in (
        ([], "images: expected at least one picture, got none"),
        (["clutter.png"], "give --masks FOLDER, --mask-below VALUE or --background R G B"),
        (["notes"], "expected pictures (.png, .jpg, .jpeg, .webp, .bmp, .tif, .tiff), got a folder without"),
    ):
        assert cli.main([*start, *(str(folder / name) for name in images), *end]) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert message in said and "--box" not in said
    assert not (folder / "out" / "report.json").exists()


def test_pictures_of_different_sizes_keep_theirs(folder: Path) -> None:
    """The cameras of a portrait and a landscape, in one file."""
    image = nr.load_image(folder / "frames" / "0.png")
    wide = torch.cat((torch.zeros(64, 16, image.shape[2]), image, torch.zeros(64, 16, image.shape[2])), 1)
    (folder / "both").mkdir()
    for name, one in (("0.png", image), ("1.png", wide)):
        nr.save_image(folder / "both" / name, one.movedim(2, 0))
    arguments = ["pose", str(folder / "box.obj"), str(folder / "both"), "-o", str(folder / "out"), "--no-photos"]
    assert cli.main([*arguments, "--viewing-angle", "18"]) == 0
    rows = json.loads((folder / "out" / "cameras.json").read_text())["views"]
    assert [(row["height"], row["width"]) for row in rows] == [(64, 64), (64, 96)]
    assert [row["K"][0][2] for row in rows] == [32, 48]
    assert rows[1]["K"][0][0] == pytest.approx(rows[0]["K"][0][0])
    assert rows[1]["t"] == pytest.approx(rows[0]["t"], rel=0.01, abs=0.01)


def test_cameras_have_the_size_of_photographs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A film that is reduced to find poses is drawn again in the size of its pictures."""
    given = [nr.load_image(folder / "frames" / f"{number}.png") for number in range(2)]
    (folder / "large").mkdir()
    for number, image in enumerate(given):
        wide = torch.cat((torch.zeros(64, 16, image.shape[2]), image, torch.zeros(64, 16, image.shape[2])), 1)
        large = torch.nn.functional.interpolate(wide.movedim(2, 0)[None], (128, 192), mode="bilinear")[0]
        nr.save_image(folder / "large" / f"{number}.png", large)
    arguments = ["pose", str(folder / "box.obj"), str(folder / "large"), "-o", str(folder / "out"), "--no-photos"]
    assert cli.main([*arguments, "--viewing-angle", "18", "--size", "96"]) == 0
    rows = json.loads((folder / "out" / "cameras.json").read_text())["views"]
    assert [(row["height"], row["width"], row["K"][0][2]) for row in rows] == [(128, 192, 96)] * 2
    drawn = folder / "drawn"
    drawn.mkdir()
    camera = str(folder / "out" / "report.json")
    command = ["render", str(folder / "box.obj"), "-o", str(drawn), "--camera", camera, "--mode", "silhouettes"]
    assert cli.main(command) == 0
    assert sorted(path.name for path in drawn.iterdir()) == ["000.png", "001.png"]
    for number in range(2):
        again, mask = (
            nr.load_image(folder / name)[..., 0] for name in (f"drawn/00{number}.png", f"large/{number}.png")
        )
        assert again.shape == (128, 192)
        assert float(nr.metrics.silhouette_iou(again[None], mask[None])) > 0.95  # the mask is enlarged


def test_photographs_are_no_silhouettes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mask = nr.load_image(folder / "frames" / "0.png")[..., :3].movedim(2, 0)
    photo = mask * torch.tensor([0.9, 0.5, 0.3])[:, None, None]
    for number, (picture, found) in enumerate(((photo, "colours in"), (1 - mask, "a white border"))):
        nr.save_image(folder / "photo.png", picture)
        start = ["pose", str(folder / "box.obj"), str(folder / "photo.png"), "-o", str(folder / f"out{number}")]
        assert cli.main([*start, "--viewing-angle", "18", "--no-photos"]) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert f"expected a silhouette, white on black, without photos, got {found}" in said and "--masks" in said
