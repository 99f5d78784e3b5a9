"""The commands `style` and `dream`: result files, interruption and resuming, error messages."""

from __future__ import annotations

import json
import shutil
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.edit import MeshEdit, edit_pictures
from tests.apps.edit.networks import saved_vgg
from tests.faults import contents

SMALL = ["--size", "32", "--batch", "2", "--turntable", "2"]
MESH = ("mesh.obj", "mesh.mtl", "mesh_texture.png", "mesh.glb")
FILES = (*MESH, "views.png", "loss.png", "turntable.mp4", "turntable.gif")


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("preview", "six_views", "turntable_pictures"):
        monkeypatch.setattr(f"neural_renderer.apps.edit.command.{name}", partial(getattr(edit_pictures, name), size=48))


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Write a mesh, a painting and the weights of a network."""
    vertices, faces = nr.icosphere(1)
    nr.save_mesh(tmp_path / "ball.obj", vertices * 3 + 5, faces)
    stripes = np.where(np.arange(40) % 8 < 4, 220, 90)[None, :, None] * np.array([1.0, 0.6, 0.3])
    Image.fromarray(np.broadcast_to(stripes, (32, 40, 3)).astype(np.uint8)).save(tmp_path / "painting.png")
    return {
        "mesh": str(tmp_path / "ball.obj"),
        "painting": str(tmp_path / "painting.png"),
        "weights": str(saved_vgg(tmp_path)),
        "out": str(tmp_path / "out"),
    }


def style(files: dict[str, str], *options: str, **other: str) -> int:
    given = files | other
    start = ["style", given["mesh"], given["painting"], "-o", given["out"], "--weights", given["weights"]]
    return cli.main([*start, "--steps", "4", *SMALL, *options])


def test_style_writes_its_results(files: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert style(files, "--texture-rate", "0.5", "--preview", "2") == 0
    told = capsys.readouterr().out
    assert "on held-out views" in told and "results are in" in told
    out = Path(files["out"])
    for name in (*FILES, "preview.png", "checkpoint.pt"):
        assert (out / name).stat().st_size > 50, name
    report = json.loads((out / "report.json").read_text())
    assert report["finished"] and report["steps"] == 4 == len(report["history"])
    assert {"phase", "loss", "style", "content", "bend", "variation", "palette"} == set(report["history"][0])
    assert report["held_out"]["before"] > 0 and report["settings"]["vertex_rate"] == 2.5e-4
    assert report["settings"]["content"] == 200
    assert sum(report["share_of_time"].values()) == pytest.approx(1, abs=0.001)
    with Image.open(out / "views.png") as picture:
        assert picture.size == (6 * 48, 2 * 48)
    # Both files show the same colours, in the coordinates of the given mesh.
    meshes = [nr.Mesh.load(out / name, 8) for name in ("mesh.obj", "mesh.glb")]
    eye = nr.get_points_from_angles(9.0, 20.0, torch.tensor([0.0, 120.0, 240.0])) + 5
    camera = nr.Camera.look_at(eye, at=(5.0, 5.0, 5.0), viewing_angle=30)
    pictures = [nr.render(mesh, camera, 96, light=None, outputs=("rgb",)).rgb for mesh in meshes]
    assert (pictures[0] - pictures[1]).abs().mean() < 0.005 and pictures[0].std() > 0.05
    for mesh in meshes:
        assert (mesh.vertices.amin(0) - 2).abs().max() < 0.2 and (mesh.vertices.amax(0) - 8).abs().max() < 0.2


def test_style_in_the_texture_coordinates_of_the_file(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert style(files, "--uv", "24") == 1
    assert "--uv: expected a mesh with texture coordinates and an image, got " in capsys.readouterr().err
    assert style(files, "--uv", "8") == 1
    assert "--uv: expected at least 16, got 8" in capsys.readouterr().err
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3 4/4\n"
    (tmp_path / "square.obj").write_text("mtllib square.mtl\n" + square)
    (tmp_path / "square.mtl").write_text("newmtl a\nmap_Kd painting.png\n")
    assert style(files, "--uv", "100000", mesh=str(tmp_path / "square.obj")) == 1
    assert "got 111.8 GiB (1 images of 100000² pixels); choose smaller images" in capsys.readouterr().err
    assert style(files, "--uv", "24", mesh=str(tmp_path / "square.obj")) == 0
    for name in FILES:
        assert (Path(files["out"]) / name).stat().st_size > 50, name
    before = nr.UVMesh.load(tmp_path / "square.obj")
    for name in ("mesh.obj", "mesh.glb"):
        mesh = nr.UVMesh.load(Path(files["out"]) / name)
        assert mesh.images[0].shape == (24, 24, 3) and len(mesh.vertices) == 4
        torch.testing.assert_close(mesh.uv, before.uv)


def test_dream_writes_its_results(files: dict[str, str]) -> None:
    arguments = ["dream", files["mesh"], "-o", files["out"], "--weights", files["weights"], "--layer", "conv3_1"]
    assert cli.main([*arguments, "--steps", "3", "--channel", "2", *SMALL]) == 0
    for name in FILES:
        assert (Path(files["out"]) / name).stat().st_size > 50, name
    report = json.loads((Path(files["out"]) / "report.json").read_text())
    assert report["settings"]["layer"] == "conv3_1" and report["settings"]["channel"] == 2
    assert "dream" in report["history"][0]


@pytest.mark.parametrize("command", ["style", "dream"])
def test_presets(files: dict[str, str], command: str, capsys: pytest.CaptureFixture[str]) -> None:
    layer = ["--layer", "conv2_1"] if command == "dream" else []
    inputs = [files["mesh"]] + ([files["painting"]] if command == "style" else [])
    found = {}
    for preset in ("paper", "published"):
        out = Path(files["out"]) / preset
        arguments = [command, *inputs, "-o", str(out), "--weights", files["weights"], "--preset", preset, *layer]
        assert cli.main([*arguments, "--steps", "1", *SMALL, "--turntable", "0"]) == 0
        warned = "its loss weights suit the features of VGG-16, not those of VGG-13" in capsys.readouterr().err
        assert warned == (preset == "published" and command == "style")
        found[preset] = json.loads((out / "report.json").read_text())["settings"]
        assert not (out / "turntable.gif").exists()
    rates = {"style": (2.5e-4, 5e-4), "dream": (5e-5, 1e-4)}[command]
    assert (found["paper"]["vertex_rate"], found["published"]["vertex_rate"]) == rates
    assert found["paper"]["texture_rate"] == {"style": 5e-2, "dream": 1e-2}[command]
    assert found["paper"]["seamless"] and not found["published"]["seamless"]


def test_interrupted_and_resumed(
    files: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert style(files, out=str(tmp_path / "whole")) == 0
    advance = MeshEdit.advance

    def interrupted(edit: MeshEdit) -> dict[str, float]:
        if edit.step == 1:
            signal.raise_signal(signal.SIGINT)
        return advance(edit)

    monkeypatch.setattr(MeshEdit, "advance", interrupted)
    assert style(files) == 130
    assert "interrupted after 2 steps (--resume continues)" in capsys.readouterr().out
    assert (Path(files["out"]) / "mesh.glb").is_file()
    monkeypatch.setattr(MeshEdit, "advance", advance)
    assert style(files, "--resume") == 0
    one, other = (nr.Mesh.load(folder / "mesh.obj") for folder in (tmp_path / "whole", Path(files["out"])))
    assert torch.equal(one.vertices, other.vertices) and torch.equal(one.textures, other.textures)
    report = json.loads((Path(files["out"]) / "report.json").read_text())
    assert report["finished"] and len(report["history"]) == 4

    # More steps, or a moved file, do not make another run.
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    Path(files["painting"]).rename(elsewhere / "painting.png")
    moved = {"painting": str(elsewhere / "painting.png")}
    assert style(files, "--resume", "--steps", "5", "--preview", "9", **moved) == 0
    for option, values, named in (
        ("--texture-size", ["3"], "(texture_size 3), got one of texture_size 4"),
        ("--size", ["40"], "(size 40), got one of size 32"),
        ("--light", ["1", "0"], "(light (1.0, 0.0)), got one of light (0.75, 0.5)"),
        ("--content", ["3"], "(content 3.0), got one of content 200.0"),
        ("--init", ["random"], "(init random), got one of init plain"),
    ):
        assert style(files, "--resume", option, *values, **moved) == 1
        assert f"expected a checkpoint of this run {named}" in capsys.readouterr().err
    assert style(files, "--resume", "--steps", "3", **moved) == 1
    assert "--steps: expected at least the 5 steps already taken, got 3" in capsys.readouterr().err
    Image.new("RGB", (40, 32)).save(elsewhere / "painting.png")
    assert style(files, "--resume", **moved) == 1
    assert "of this run (painting painting.png #" in capsys.readouterr().err
    (Path(files["out"]) / "checkpoint.pt").write_text("text")
    assert style(files, "--resume", **moved) == 1
    assert "expected a checkpoint, got another file" in capsys.readouterr().err


def test_results_are_replaced_only_if_asked_for(files: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert style(files) == 0
    out, found = Path(files["out"]), {"report.json", "checkpoint.pt"}
    kept = shutil.copytree(out, out.with_name("kept"))
    for left in (found, {"report.json"}, {"checkpoint.pt"}):
        shutil.copytree(kept, out, dirs_exist_ok=True)
        for name in found - left:
            (out / name).unlink()
        before = contents(out)
        capsys.readouterr()
        assert style(files, "--seed", "1") == 1
        resume = "--resume continues it, " if "checkpoint.pt" in left else ""
        assert capsys.readouterr().err == (
            f"--output: expected a folder without results, got {out}, which has those of an earlier run; "
            f"{resume}--force replaces it, another folder keeps it\n"
        )
        assert style(files, "--seed", "1", "--resume") == 1  # with a checkpoint it is one of seed 0
        assert contents(out) == before
    assert style(files, "--seed", "1", "--force") == 0 and contents(out) != before


def test_grey_and_transparent_paintings(files: dict[str, str], tmp_path: Path) -> None:
    with Image.open(files["painting"]) as image:
        image.convert("L").save(tmp_path / "grey.png")
        image.putalpha(Image.linear_gradient("L").resize(image.size))
        image.save(tmp_path / "clear.png")
    means = {}
    for name in ("grey.png", "clear.png"):
        given = {"painting": str(tmp_path / name), "out": str(tmp_path / f"{name} out")}
        assert style(files, "--turntable", "0", "--steps", "1", "--texture-rate", "1e-6", **given) == 0
        # A mesh without colours begins in the mean colour of the painting, with a little noise; a tiny rate keeps it.
        color = nr.Mesh.load(Path(given["out"]) / "mesh.obj").textures.flatten(0, -2)
        assert float((color - color.mean(0)).abs().max()) < 0.1
        means[name] = color.mean(0)
    grey, clear = means["grey.png"], means["clear.png"]
    assert float(grey.max() - grey.min()) < 4 / 255
    # The opacity grows downwards alike in all columns, so the mean of stripes stays.
    with Image.open(files["painting"]) as image:
        mean = torch.from_numpy(np.asarray(image, np.float32)).flatten(0, 1).mean(0) / 255
    assert float((clear - mean).abs().max()) < 4 / 255
    assert abs(float(grey.mean()) - float(mean @ torch.tensor([0.299, 0.587, 0.114]))) < 4 / 255


def test_what_is_refused(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (tmp_path / "text.png").write_text("no picture")
    Image.new("RGBA", (40, 40)).save(tmp_path / "nothing.png")
    Image.new("RGB", (4, 4)).save(tmp_path / "tiny.png")
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr("neural_renderer.apps.edit.paint._MOST_BYTES", 2**20)
    for options, other, sentence in (
        ([], {"mesh": str(tmp_path / "points.obj")}, "points.obj: expected faces"),
        ([], {"mesh": str(tmp_path / "none.obj")}, "none.obj: expected a file"),
        ([], {"painting": str(tmp_path / "text.png")}, "text.png: expected a picture"),
        ([], {"painting": str(tmp_path / "nothing.png")}, "got a picture that is fully transparent"),
        ([], {"painting": str(tmp_path / "tiny.png")}, "expected sides of at least 16 pixels"),
        ([], {"weights": files["mesh"]}, "ball.obj: expected a PyTorch checkpoint"),
        ([], {"out": str(tmp_path / "file")}, "--output: expected a folder that can be written, got "),
        ([], {"out": str(tmp_path / "file" / "below")}, "file/below (Not a directory)"),
        (["--painting-scale", "100"], {}, "--painting-scale: expected at most 64 for images of 32 pixels, got 100"),
        (["--content", "-1"], {}, "--content: expected a number of at least 0, got -1"),
        (["--palette", "inf"], {}, "--palette: expected a finite number, got inf"),
        (["--steps", "0"], {}, "--steps: expected at least 1, got 0"),
        (["--size", "16"], {}, "--size: expected at least 32, got 16"),
        (["--layers", "conv2_3"], {}, "expected one of conv1_1, conv1_2,"),
        (["--elevation", "40", "20"], {}, "--elevation: expected two numbers between -90 and 90"),
        (["--distance", "-1"], {}, "--distance: expected a finite number above 0"),
        (["--distance", "0.5"], {}, "--distance: expected a number from 1.8 to 50"),
        (["--light", "0.5", "-1"], {}, "--light: expected two numbers of at least 0"),
        (["--settle", "2"], {}, "--settle: expected a fraction in [0, 1]"),
        (["--texture-size", "2"], {}, "--texture-size: expected at least 3, got 2"),
        (["--texture-size", "20"], {}, "of 20³ texels); choose a smaller texture size, or a mesh with fewer faces"),
    ):
        assert style(files, *options, **other) == 1
        said = capsys.readouterr().err
        assert sentence in " ".join(said.split()) and said.count("\n") == 1

    def offline(address: str, **options: object) -> None:
        raise OSError("no route to host")

    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", offline)
    assert cli.main(["style", files["mesh"], files["painting"], "-o", files["out"]]) == 1
    assert capsys.readouterr().err.endswith("; download it elsewhere and give the path of the file with --weights\n")
    assert not Path(files["out"]).exists()
