"""Outputs of a command never replace its inputs, nor foreign files beside its mesh."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.checks import check_outputs
from neural_renderer.apps.common.named_files import names_file
from tests.faults import contents, full_disk


def ball(path: Path) -> Path:
    vertices, faces = nr.icosphere(1)
    nr.Mesh(vertices, faces, torch.rand(len(faces), 2, 2, 2, 3)).save(path)
    return path


def picture(path: Path) -> Path:
    nr.save_image(path, torch.rand(3, 9, 9))
    return path


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one sentence of a command that ends with 1."""
    assert cli.main(list(map(str, arguments))) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_render_leaves_the_images_of_its_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = ball(tmp_path / "a.obj")
    before = contents(tmp_path)
    said = fails(capsys, "render", mesh, "-o", tmp_path / "a_texture.png", "--size", "16")
    assert (
        f"--output: expected a file that may be replaced, got {tmp_path / 'a_texture.png'}, which {mesh} uses" in said
    )
    assert contents(tmp_path) == before
    for _ in range(2):  # a picture of the mesh may be drawn again, in its folder and elsewhere
        for output in (tmp_path / "a.png", tmp_path / "out" / "a_texture.png"):
            assert cli.main(["render", str(mesh), "-o", str(output), "--size", "16"]) == 0


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        ("a.obj", "mtllib a.mtl"),
        ("a.obj", "mtllib b.mtl a.mtl"),
        ("a.OBJ", "  MTLLIB a.mtl\r"),
        ("a.ply", "ply\ncomment TextureFile my skin.png\n"),
        ("a.gltf", json.dumps({"images": [{"uri": "my%20skin.png"}]})),
        ("a.glb", "glTF" + json.dumps({"images": [{"uri": "my skin.png"}]}, separators=(",", ":"))),
        ("a.json", json.dumps({"frames": [{"file_path": "./my skin"}]})),
        ("a.csv", "file,azimuth\nmy skin.png,30\n"),
    ],
)
@pytest.mark.parametrize("line", ["map_Kd my skin.png", "Bump -bm 0.5 C:\\skins\\MY SKIN.PNG", "norm ./my skin.png"])
def test_files_that_files_name(tmp_path: Path, mesh: str, text: str, line: str) -> None:
    (tmp_path / mesh).write_text(text)
    (tmp_path / "a.mtl").write_text(f"newmtl a\n{line}\n")
    (tmp_path / "elsewhere").mkdir()
    for other, expected in (("my skin.png", True), ("kin.png", False), ("elsewhere/my skin.png", False)):
        assert names_file(tmp_path / mesh, picture(tmp_path / other)) == expected, other


def test_files_outside_of_the_folder(tmp_path: Path) -> None:
    skin = picture(tmp_path / "skins" / "a.png")
    (tmp_path / "a.mtl").write_text(f"map_Kd {skin}\nmap_Ks b.png")
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "a.obj").write_text("mtllib a.mtl\n")
    (tmp_path / "models" / "a.mtl").write_text("map_Kd ../skins/a.png\n")
    os.symlink(skin, tmp_path / "link.png")
    assert names_file(tmp_path / "models" / "a.obj", skin) and names_file(tmp_path / "a.mtl", skin)
    assert names_file(tmp_path / "a.mtl", tmp_path / "link.png")


def test_an_input_is_no_output(tmp_path: Path) -> None:
    skin = picture(tmp_path / "a.png")
    check_outputs([tmp_path / "new.png"], [skin, None, tmp_path / "nowhere.png"])
    os.symlink(skin, tmp_path / "link.png")
    with pytest.raises(ValueError, match=r"output: .* got .*link\.png, which is an input"):
        check_outputs([tmp_path / "link.png"], [skin])


@pytest.mark.parametrize("command", ["fit", "style", "dream", "demo"])
def test_what_lies_beside_the_result(tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """It is refused before any work begins, here before a broken mesh is read."""
    (tmp_path / "none.obj").write_text("")
    picture(tmp_path / "none.png")
    start = {
        "fit": ["fit", tmp_path, "-o", tmp_path],
        "style": ["style", tmp_path / "none.obj", tmp_path / "none.png", "-o", tmp_path],
        "dream": ["dream", tmp_path / "none.obj", "-o", tmp_path],
        "demo": ["demo", "-o", tmp_path],
    }[command]
    (tmp_path / "cameras.json").write_text("{}")
    name = "fitted" if command == "demo" else "mesh"
    for other in (tmp_path / f"{name}_texture_2.png", tmp_path / f"{name}.mtl"):
        picture(tmp_path / "somebody's.png").rename(other)
        before = contents(tmp_path)
        said = fails(capsys, *start)
        assert f"{other}: expected no file, or one that was written with {name}.obj, got a foreign file" in said
        assert contents(tmp_path) == before
        if command == "demo":
            assert "; -o names another folder" in said
        else:
            assert "; --force replaces it" in said
            assert other.name not in fails(capsys, *start, "--force")
        other.unlink()


@pytest.mark.parametrize("command", ["fit", "fit camera", "style", "dream"])
def test_results_on_top_of_inputs(tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, _ = ball(tmp_path / "mesh.obj"), picture(tmp_path / "comparison.png")
    view = {"file": "comparison.png", "azimuth": 0, "elevation": 0, "distance": 3}
    (tmp_path / "cameras.json").write_text(json.dumps({"viewing_angle": 30, "views": [view]}))
    arguments = {
        "fit": ["fit", tmp_path],
        "fit camera": [
            "fit",
            picture(tmp_path / "overlay.png"),
            "--recover",
            "camera",
            "--mesh",
            ball(tmp_path / "a.obj"),
        ],
        "style": ["style", ball(tmp_path / "b.obj"), picture(tmp_path / "views.png")],
        "dream": ["dream", mesh],
    }[command]
    before = contents(tmp_path)
    assert cli.main([*map(str, arguments), "-o", str(tmp_path), "--force"]) == 1
    said = capsys.readouterr().err.splitlines()[-1]  # `fit` first says what it will make of the images
    assert said.startswith("--output: expected a file that may be replaced, got ")
    assert contents(tmp_path) == before


def test_a_full_disk_is_one_sentence_with_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = ball(tmp_path / "a.obj")
    command = ("render", mesh, "-o", tmp_path / "a.png", "--size", "64")
    cli.main(list(map(str, command)))  # compiles the kernels, which are files, too
    capsys.readouterr()
    with full_disk(100):
        said = fails(capsys, *command)
    assert f"{tmp_path / 'a.png'}: expected to write it, got: File too large\n" == said
