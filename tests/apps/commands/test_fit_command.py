"""The command `fit`: result files, interruption and resuming, error messages."""

from __future__ import annotations

import json
import math
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.fit import DetailWeights, MeshFit, Views, load_views
from neural_renderer.apps.fit.commands.cameras import without_missing
from neural_renderer.apps.fit.commands.fit import _all_facts
from neural_renderer.apps.fit.options import FitOptions
from neural_renderer.camera.files import read_camera_file
from tests.rounding import STEP

EYES = nr.get_points_from_angles(3.0, torch.tensor([70.0, 10, -35, 20, 40, -5]), torch.arange(6) * 60.0)


def thing() -> nr.Mesh:
    vertices, faces = nr.icosphere(2)
    cubes = (vertices[faces.long()].mean(1) * 0.5 + 0.5)[:, None, None, None].expand(-1, 2, 2, 2, -1)
    return nr.Mesh(vertices * torch.tensor([0.9, 0.5, 0.7]), faces, cubes)


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write six images with transparency, and their cameras in all three formats."""
    folder = tmp_path_factory.mktemp("originals")
    camera = nr.Camera.look_at(EYES, viewing_angle=22.0)
    views = Views.of(thing(), camera, 48)
    frames, rows = [], []
    for index in range(6):
        colour = views.photos[index] / views.masks[index].clamp(min=1e-6)  # type: ignore[index]
        nr.save_image(folder / f"r_{index}.png", torch.cat((colour, views.masks[index][None])))
        right, up, forward = camera.rotation[index]
        matrix = torch.eye(4)
        matrix[:3] = torch.stack((right, up, -forward, camera.origin[index]), 1)
        frames.append({"file_path": f"./r_{index}", "transform_matrix": matrix.tolist()})
        elevation = math.degrees(math.asin(EYES[index, 1] / 3))
        azimuth = math.degrees(math.atan2(EYES[index, 0], -EYES[index, 2]))
        rows.append({"file": f"r_{index}.png", "azimuth": azimuth, "elevation": elevation, "distance": 3.0})
    nerf = {"camera_angle_x": math.radians(44), "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(nerf))
    (folder / "cameras.json").write_text(json.dumps({"viewing_angle": 22, "views": rows}))
    lines = [",".join([*rows[0], "viewing_angle"]), *(",".join([*map(str, row.values()), "22"]) for row in rows)]
    (folder / "cameras.csv").write_text("\n".join(lines))
    return folder


@pytest.fixture
def folder(originals: Path, tmp_path: Path) -> Path:
    """Copy the six images and their cameras, which a test may change."""
    shutil.copytree(originals, tmp_path, dirs_exist_ok=True)
    return tmp_path


SMALL = ["--cells=20", "--steps=4", "--detail-steps=0", "--texture-steps=4", "--turntable=1", "--batch=3"]


@pytest.mark.parametrize("name", ["transforms.json", "cameras.json", "cameras.csv"])
def test_cameras_in_files(folder: Path, name: str) -> None:
    views = load_views(folder / name)
    mesh = thing()
    quality = views.quality((mesh.vertices.detach(), mesh.faces, mesh.textures.detach()))
    # The file rounds cameras, so pixels with samples very near to an edge may differ.
    assert len(views) == 6 and quality["iou"].min() > 0.995 and quality["psnr"].min() > 40
    smaller = load_views(folder / name, size=24)
    assert smaller.size == (24, 24) and smaller.quality((mesh.vertices.detach(), mesh.faces))["iou"].min() > 0.93


def test_intrinsics_in_pixels(folder: Path) -> None:
    given = json.loads((folder / "transforms.json").read_text())
    del given["camera_angle_x"]
    focal = 480 / math.tan(math.radians(22))  # of images ten times as large
    given |= {"fl_x": focal, "fl_y": focal, "cx": 480, "cy": 480, "w": 960, "h": 960}
    (folder / "transforms.json").write_text(json.dumps(given))
    mesh = thing()
    assert load_views(folder).quality((mesh.vertices.detach(), mesh.faces))["iou"].min() > 0.995


def test_masks_and_backgrounds(folder: Path) -> None:
    views = load_views(folder)
    for index in range(6):
        pixels = torch.cat((views.photos[index], views.masks[index][None]))  # type: ignore[index]
        nr.save_image(folder / f"m_{index}.png", pixels[3])
        nr.save_image(folder / f"r_{index}.png", pixels[:3] + (1 - pixels[3]))
    plain, white = load_views(folder).masks, load_views(folder, background=(1.0, 1.0, 1.0)).masks
    assert (plain - views.masks).abs().mean() < 0.03 and (white - views.masks).abs().mean() < 0.03
    wider = load_views(folder, background=(1.0, 1.0, 1.0), tolerance=0.6).masks
    assert wider.sum() < 0.9 * white.sum()
    noise = torch.rand(3, 48, 48, generator=torch.Generator().manual_seed(0))
    pixels = torch.cat((views.photos[3], views.masks[3][None]))  # type: ignore[index]
    nr.save_image(folder / "r_3.png", pixels[:3] + (1 - pixels[3]) * noise)
    with pytest.raises(
        ValueError, match=r"r_3\.png: expected an alpha channel, a mask or a plain background .*background=R G B"
    ):
        load_views(folder)
    given = json.loads((folder / "cameras.json").read_text())
    for index, row in enumerate(given["views"]):
        row["mask"] = f"m_{index}.png"
    (folder / "cameras.json").write_text(json.dumps(given))
    masked = load_views(folder / "cameras.json")
    assert torch.allclose(masked.masks, views.masks, atol=0.51 * STEP)
    for index, row in enumerate(given["views"]):
        row["file"] = f"m_{index}.png"
    (folder / "cameras.json").write_text(json.dumps(given))
    silhouettes = load_views(folder / "cameras.json", photos=False)
    assert silhouettes.photos is None and torch.allclose(silhouettes.masks, views.masks, atol=0.51 * STEP)


def test_fit_writes_its_results(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert cli.main(["fit", str(folder), "-o", str(out), "--held-out", "3", *SMALL]) == 0
    assert "held-out views: iou" in capsys.readouterr().out
    pictures = ("mesh_texture.png", "preview.png", "comparison.png", "loss.png", "turntable.gif")
    for name in ("mesh.obj", "mesh.glb", *pictures):
        assert (out / name).stat().st_size > 100
    report = json.loads((out / "report.json").read_text())
    assert report["finished"] and report["views"] == 4 and len(report["history"]) == 8
    assert report["fitted"]["iou"]["mean"] > 0.85
    mesh = nr.Mesh.load(out / "mesh.glb")
    assert (mesh.vertices.amax(0) - torch.tensor([0.9, 0.5, 0.7])).abs().max() < 0.15
    with Image.open(out / "comparison.png") as picture:
        assert picture.size == (4 * 48, 3 * 48)


def test_interrupted_and_resumed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["fit", str(folder), "-o", str(tmp_path / "a"), *SMALL]
    advance = MeshFit.advance

    def interrupted(fit: MeshFit) -> dict[str, float]:
        if fit.step == 2:
            signal.raise_signal(signal.SIGINT)
        return advance(fit)

    monkeypatch.setattr(MeshFit, "advance", interrupted)
    assert cli.main(arguments) == 130
    assert not json.loads((tmp_path / "a" / "report.json").read_text())["finished"]
    assert (tmp_path / "a" / "mesh.obj").is_file()
    monkeypatch.setattr(MeshFit, "advance", advance)
    assert cli.main([*arguments, "--gradient", "nmr", "--resume"]) == 1
    assert "expected a checkpoint of this run (gradient nmr), got one of gradient edge" in capsys.readouterr().err
    assert cli.main([*arguments, "--size", "40", "--resume"]) == 1
    assert "size 40" in capsys.readouterr().err
    checkpoint = torch.load(tmp_path / "a" / "checkpoint.pt", weights_only=True)
    torch.save({**checkpoint, "task": {"step": 2}}, tmp_path / "a" / "checkpoint.pt")
    assert cli.main([*arguments, "--resume"]) == 1
    assert "got one of another version (it has no 'phase')" in capsys.readouterr().err.replace("\n", " ")
    torch.save(checkpoint, tmp_path / "a" / "checkpoint.pt")
    assert cli.main([*arguments, "--resume"]) == 0
    arguments[3] = str(tmp_path / "b")
    assert cli.main(arguments) == 0
    histories = [json.loads((tmp_path / name / "report.json").read_text())["history"] for name in "ab"]
    assert histories[0] == histories[1]


def test_interruption_beside_the_steps_says_how_to_continue(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    arguments = ["fit", str(folder), "-o", str(folder / "out"), *SMALL]
    for name, way in (("load_views", "the same command"), ("_write_mesh", "--resume")):
        with monkeypatch.context() as patch:
            patch.setattr(f"neural_renderer.apps.fit.commands.fit.{name}", interrupted)
            assert cli.main(arguments) == 130
        assert capsys.readouterr().err.endswith(f"interrupted: {way} continues\n")


def test_maps_of_normals_are_followed_and_resumed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "normals").mkdir()
    normals = Views.of(thing(), nr.Camera.look_at(EYES, viewing_angle=22.0), 48, normals=True).normals
    for index, image in enumerate(normals):  # type: ignore[arg-type]
        nr.save_image(folder / "normals" / f"r_{index}.png", (image + 1) / 2)
    arguments = ["fit", str(folder), "-o", str(tmp_path / "a"), *SMALL, "--detail-steps", "4"]
    advance = MeshFit.advance

    def interrupted(fit: MeshFit) -> dict[str, float]:
        if fit.phase == "detail" and fit.step == 2:
            signal.raise_signal(signal.SIGINT)
        return advance(fit)

    monkeypatch.setattr(MeshFit, "advance", interrupted)
    assert cli.main(arguments) == 130
    assert (tmp_path / "a" / "preview.png").is_file()
    monkeypatch.setattr(MeshFit, "advance", advance)
    capsys.readouterr()
    assert cli.main([*arguments, "--detail-weights.normals", "2", "--resume"]) == 1
    name = "detail_weights.normals"
    mine, theirs = f"{name} 2.0", f"{name} {DetailWeights().normals}"
    assert capsys.readouterr().err.endswith(f": expected a checkpoint of this run ({mine}), got one of {theirs}\n")
    assert cli.main([*arguments, "--resume"]) == 0
    arguments[3] = str(tmp_path / "b")
    assert cli.main(arguments) == 0
    histories = [json.loads((tmp_path / name / "report.json").read_text())["history"] for name in "ab"]
    assert histories[0] == histories[1]
    assert [row["phase"] for row in histories[0]] == ["shape"] * 4 + ["detail"] * 4 + ["texture"] * 4
    arguments[3] = str(tmp_path / "c")
    assert cli.main([*arguments, "--no-maps", "--no-photos"]) == 1
    assert "--detail-steps: expected 0 for views without normals and depth" in capsys.readouterr().err


def test_the_report_of_a_resumed_run_keeps_what_the_first_knew_of_its_photographs(tmp_path: Path) -> None:
    first = {"masks": {"transparency": 6}, "placed": 6, "seconds": 40.0}
    (tmp_path / "report.json").write_text(json.dumps({"photographs": first}))
    again = {"masks": {"files in out/masks": 6}, "placed": 6, "seconds": 2.5}
    options = FitOptions(tmp_path / "photos", output=tmp_path, resume=True)
    assert _all_facts(options, again) == first | {"seconds": 42.5}
    assert _all_facts(replace(options, resume=False), again) == again


def test_gains_are_in_the_report(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Image.open(folder / "r_1.png") as picture:
        red, green, blue, alpha = picture.split()
    Image.merge("RGBA", (red.point(lambda value: value // 2), green, blue, alpha)).save(folder / "r_1.png")
    out = tmp_path / "out"
    assert cli.main(["fit", str(folder / "cameras.json"), "-o", str(out), "--exposure", "--held-out", "3", *SMALL]) == 0
    assert "with exposure matched to the result" in capsys.readouterr().out.replace("\n", " ")
    report = json.loads((out / "report.json").read_text())
    assert set(report["gains"]) == {"r_0.png", "r_1.png", "r_3.png", "r_4.png"}
    assert min(report["gains"], key=lambda name: report["gains"][name][0] / report["gains"][name][1]) == "r_1.png"
    assert report["held_out_exposed"]["psnr"]["mean"] >= report["held_out"]["psnr"]["mean"]
    assert cli.main(["fit", str(folder), "-o", str(out), "--exposure", "--no-photos"]) == 1
    assert "--exposure: expected the colours of photos, got --no-photos" in capsys.readouterr().err


def test_details_follow_colors_by_default(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["fit", str(folder), "-o", str(tmp_path / "out"), *SMALL, "--detail-steps", "2"]
    assert cli.main(arguments) in (0, 3)  # after so few steps
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [row["phase"] for row in report["history"]] == ["shape"] * 4 + ["detail"] * 2 + ["texture"] * 4
    assert cli.main([*arguments, "--light", "fitted", "--no-photos"]) == 1
    assert "--light: expected the colours of photos, got --no-photos" in capsys.readouterr().err


def test_texture_and_camera_of_a_known_mesh(folder: Path, tmp_path: Path) -> None:
    thing().save(tmp_path / "thing.obj")
    known = ["--mesh", str(tmp_path / "thing.obj"), *SMALL]
    assert cli.main(["fit", str(folder), "-o", str(tmp_path / "t"), "--recover", "texture", *known]) == 0
    assert nr.Mesh.load(tmp_path / "t" / "mesh.obj").num_faces == 320
    photo = ["fit", str(folder / "r_0.png"), "-o", str(tmp_path / "c"), "--recover", "camera"]
    assert cli.main([*photo, *known, "--viewing-angle", "22"]) == 0
    assert len(json.loads((tmp_path / "c" / "report.json").read_text())["camera"]["eye"]) == 3


def test_wrong_cameras_are_told_before_and_after(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = json.loads((folder / "transforms.json").read_text())
    for frame in given["frames"]:  # OpenCV's axes instead of OpenGL's
        for row in frame["transform_matrix"][:3]:
            row[1], row[2] = -row[1], -row[2]
    (folder / "transforms.json").write_text(json.dumps(given))
    command = ["fit", str(folder), "-o", str(tmp_path / "out"), *SMALL]
    assert cli.main(command) == 1
    error = capsys.readouterr().err
    assert "masks and cameras that agree, got 6 views that do not" in error and not (tmp_path / "out").exists()
    assert "OpenCV's camera axes" in error and "--no-check fits anyway" in error


def test_result_that_does_not_match_the_masks(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["fit", str(folder), "-o", str(tmp_path / "out"), *SMALL, "--start", "sphere", "--steps", "1"]
    assert cli.main(command) == 3
    assert "expected an IoU of at least 0.8, got 0." in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "out" / "report.json").is_file()


def test_masks_of_a_folder_and_a_box(folder: Path) -> None:
    views = load_views(folder)
    (folder / "masks").mkdir()
    for index in range(6):
        photo, mask = views.photos[index], views.masks[index]  # type: ignore[index]
        nr.save_image(folder / f"r_{index}.png", photo + (1 - mask) * 0.5)
        nr.save_image(folder / "masks" / f"r_{index}.png", mask)
    assert torch.allclose(load_views(folder).masks, views.masks, atol=0.51 * STEP)
    (folder / "masks").rename(folder / "others")
    assert torch.allclose(load_views(folder, masks=folder / "others").masks, views.masks, atol=0.51 * STEP)
    with pytest.raises(FileNotFoundError, match=r"masks: expected a folder of masks, got .*, which is none"):
        load_views(folder, masks=folder / "nothing")
    boxed = load_views(folder, masks=folder / "others", box=(0, -2, -2, 2, 2, 2))
    assert boxed.masks.sum() < 0.9 * views.masks.sum() and boxed.region is not None and boxed.region[1] == 2


def changed(folder: Path, **values: Any) -> None:
    given = json.loads((folder / "transforms.json").read_text())
    given["frames"][1].update(values)
    given["frames"][1] = {key: value for key, value in given["frames"][1].items() if value is not None}
    (folder / "transforms.json").write_text(json.dumps(given))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda f: (f / "transforms.json").write_text("{}"), 'expected the key "frames"'),
        (lambda f: (f / "transforms.json").write_text("{"), "expected JSON"),
        (lambda f: (f / "transforms.json").write_text('{"frames": []}'), "expected at least one image"),
        (lambda f: changed(f, transform_matrix=None), 'expected the key "transform_matrix"'),
        (lambda f: changed(f, transform_matrix=[[1.0]]), "expected 4 x 4 finite numbers"),
        (lambda f: changed(f, transform_matrix=(2 * torch.eye(4)).tolist()), "expected a rotation"),
        (lambda f: changed(f, file_path="nothing.png"), "got nothing there; --skip-bad leaves the image out"),
        (lambda f: (f / "r_2.png").write_text("text"), "of an unknown format, none of PNG"),
        (lambda f: Image.new("RGBA", (48, 48)).save(f / "r_2.png"), "got an empty one"),
        (lambda f: Image.new("RGBA", (24, 48), "red").save(f / "r_2.png"), "expected 48 x 48 pixels"),
    ],
)
def test_bad_input(folder: Path, spoil: Any, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    spoil(folder)
    assert cli.main(["fit", str(folder), "-o", str(folder / "out")]) == 1
    error = capsys.readouterr().err
    assert sentence in error and len(error.strip().splitlines()) == 1
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("transforms.json", "[" * 100_000, "expected JSON, got "),
        ("transforms.json", '{"frames": ' + "1" * 5000, "expected JSON, got "),
        ("cameras.csv", "file,azimuth\n" + "x" * 200_000 + ",1", "expected CSV, got a file that cannot be parsed"),
        ("cameras.csv", "file,azimuth,elevation,distance\n" + "x" * 5000 + ",1,2,3", "expected a file 'xxx"),
    ],
)
def test_hostile_camera_files(tmp_path: Path, name: str, text: str, sentence: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises((ValueError, FileNotFoundError), match=rf"{name}: {sentence}") as error:
        load_views(tmp_path / name)
    assert len(str(error.value)) < len(str(tmp_path)) + 250


HOSTILE = {
    "long": 10**400,
    "large": "1e39",
    "small": [[1]],
    "object": {"a": 1},
    "text": "x" * 5000,
    "integers": [[10**30] * 4] * 4,
    "past float32": [[1e300] * 4] * 4,
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_numbers(folder: Path, kind: str) -> None:
    for key in ("transform_matrix", "fl_x"):
        changed(folder, **({"transform_matrix": torch.eye(4).tolist()} | {key: HOSTILE[kind]}))
        with pytest.raises(ValueError, match=rf"transforms\.json: image 1: {key}: expected .*, got") as error:
            load_views(folder)
        assert len(str(error.value)) < len(str(folder)) + 250


@pytest.mark.parametrize("key", ["file_path", "mask_path"])
@pytest.mark.parametrize("absolute", [False, True])
def test_images_outside_are_read_only_if_asked_for(folder: Path, key: str, absolute: bool) -> None:
    inner = folder / "cameras"
    inner.mkdir()
    given = json.loads((folder / "transforms.json").read_text())
    for frame in given["frames"]:
        frame["file_path"] = f"../{frame['file_path']}" if key == "file_path" else f"{frame['file_path']}.png"
    if key == "mask_path":
        for path in folder.glob("*.png"):
            path.rename(inner / path.name)
        (inner / "r_0.png").rename(folder / "mask.png")
        (inner / "r_0.png").write_bytes((folder / "mask.png").read_bytes())
    name = "mask.png" if key == "mask_path" else "r_0.png"
    given["frames"][0][key] = str(folder / name) if absolute else f"../{name}"
    (inner / "transforms.json").write_text(json.dumps(given))
    with pytest.raises(ValueError, match=r"transforms\.json: expected names of files .*allow_outside=True"):
        load_views(inner)
    assert len(load_views(inner, allow_outside=True)) == 6
    if not absolute and key == "file_path":
        command = ["fit", str(inner), "-o", str(folder / "out"), *SMALL]
        assert cli.main(command) == 1 and cli.main([*command, "--allow-outside"]) == 0


def test_eight_images_of_many_that_are_named_are_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The fox of instant-ngp names 50: with 17 of them a fit goes on, and says in one line how many are missing."""
    frames = [{"file_path": f"{number}.png", "transform_matrix": torch.eye(4).tolist()} for number in range(30)]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    source, options = read_camera_file(tmp_path / "transforms.json"), FitOptions(tmp_path, tmp_path / "out")
    for number in range(3, 11):
        assert without_missing(options, source) is source and not capsys.readouterr().err
        (tmp_path / f"{number}.png").touch()
    left = without_missing(options, source)
    assert [entry.name for entry in left.images] == [f"{number}.png" for number in range(3, 11)]
    told = capsys.readouterr().err
    assert "transforms.json names 22 images that are not there (0.png, …): 8 are left" in told.replace("\n", " ")


def test_bad_photos_are_skipped_if_asked_for(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "r_0.png").write_bytes((folder / "r_0.png").read_bytes()[:300])
    (folder / "r_2.png").unlink()
    Image.new("RGBA", (24, 48), "red").save(folder / "r_5.png")
    command = ["fit", str(folder / "transforms.json"), "-o", str(tmp_path / "out"), *SMALL]
    assert cli.main(command) == 1 and "r_2" in capsys.readouterr().err
    assert cli.main([*command, "--skip-bad", "--no-check"]) in (0, 3)  # three views say little
    told = capsys.readouterr().err
    assert told.count(" is skipped: ") == 3
    skipped = json.loads((tmp_path / "out" / "report.json").read_text())["skipped"]
    assert list(skipped) == ["./r_0", "./r_2", "./r_5"]
    for why, expected in zip(
        skipped.values(), ("cannot be read", "expected a file", "expected 48 x 48 pixels"), strict=True
    ):
        assert expected in why and why in told
    (folder / "r_3.png").unlink()
    assert cli.main([*command, "--skip-bad", "--force"]) == 1
    assert "expected at least 3 of 6 images that can be used, got 2; " in capsys.readouterr().err
    bad: dict[str, str] = {}
    with pytest.raises(ValueError, match=r"transforms\.json: expected at least 3 of 6 images"):
        load_views(folder / "transforms.json", bad=bad)
    assert len(bad) == 4


def test_refined_cameras_find_the_images_beside_them(folder: Path) -> None:
    out = folder / "out"
    (out / "images").mkdir(parents=True)
    for name in ("cameras.json", *(f"r_{index}.png" for index in range(6))):
        (folder / name).rename(out / "images" / name)
    quick = ["--camera-steps", "2", *SMALL]
    assert cli.main(["fit", str(out / "images"), "-o", str(out), "--refine-cameras", *quick]) in (0, 3)
    assert cli.main(["fit", str(out / "cameras.json"), "-o", str(folder / "again"), *quick]) in (0, 3)
    assert json.loads((folder / "again" / "report.json").read_text())["views"] == 6


def test_bad_options(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, sentence in (
        ([str(tmp_path / "nothing")], "expected a folder of images or a camera file"),
        (
            [str(folder / "r_0.png")],
            "r_0.png: expected a folder of at least 3 photographs, or a video, got one picture",
        ),
        ([str(folder), "--masks", "nix"], "nix: expected a folder of masks, got nothing there"),
        (
            [str(folder), "--masks", str(folder / "r_0.png")],
            f"{folder / 'r_0.png'}: expected a folder of masks, got a file",
        ),
        ([str(folder), "--recover", "texture"], "--mesh: expected a mesh for --recover texture, got none"),
        ([str(folder), "--up", "0", "0", "0"], "--up: expected a direction, got 0.0 0.0 0.0"),
        ([str(folder), "--up", "nan", "0", "1"], "--up: expected a direction, got nan 0.0 1.0"),
        ([str(folder), "--cells", "5000"], "--cells: expected at most 512, got 5000"),
        ([str(folder), "--recover", "texture", "--light", "none"], "--light: expected --recover shape, got --recover"),
        ([str(folder), "--background", "0", "0", "0", "--tolerance", "3"], "--tolerance: expected a number in [0, 1]"),
        ([str(folder), "--steps", "0"], "--steps: expected at least 1"),
        ([str(folder), "--held-out", "9"], "--held-out: expected at most 6, the number of views"),
        ([str(folder), "--color-from", "2", *SMALL], "--color-from: expected a fraction in [0, 1]"),
    ):
        assert cli.main(["fit", *arguments, "-o", str(tmp_path / "out")]) == 1
        assert sentence in capsys.readouterr().err
    (tmp_path / "out").mkdir(exist_ok=True)
    (tmp_path / "out" / "checkpoint.pt").write_text("text")
    assert cli.main(["fit", str(folder), "-o", str(tmp_path / "out"), "--resume", *SMALL]) == 1
    assert "expected a checkpoint" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("distance", 0, "distance: expected a number above 0, got 0"),
        ("viewing_angle", 90, "viewing_angle: expected deg"),
        ("elevation", -90, "image 2: elevation: expected an angle other than ±90 degrees, got -90"),
        ("azimuth", None, 'image 2: expected a value for the key "azimuth", got none'),
    ],
)
def test_impossible_cameras_are_named(folder: Path, key: str, value: float, sentence: str) -> None:
    given = json.loads((folder / "cameras.json").read_text())
    given["views"][2][key] = value
    (folder / "cameras.json").write_text(json.dumps(given))
    with pytest.raises(ValueError, match=f"cameras.json.*{sentence}"):
        load_views(folder / "cameras.json")


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("camera_angle_x", 60, "camera_angle_x: expected radians below π, got 60"),
        ("camera_angle_x", 0, "camera_angle_x: expected a number above 0"),
        ("fl_x", -100, "fl_x: expected a number above 0, got -100"),
        ("h", 0, "h: expected a number above 0"),
        ("w", 100, 'expected the key "h"'),
        (
            "camera_model",
            "EQUIRECTANGULAR",
            "camera_model: expected OPENCV, PINHOLE or OPENCV_FISHEYE, got 'EQUIRECTANGULAR'",
        ),
    ],
)
def test_impossible_lenses_are_named(folder: Path, key: str, value: object, sentence: str) -> None:
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]
    given = {"camera_angle_x": 0.8, "frames": [{"file_path": "r_2.png", "transform_matrix": pose}], key: value}
    (folder / "transforms.json").write_text(json.dumps(given))
    with pytest.raises(ValueError, match=sentence):
        load_views(folder / "transforms.json")


def test_background_in_eight_bits_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match=r"background: expected red, green and blue in \[0, 1\]"):
        load_views(folder, background=(255, 255, 255))
