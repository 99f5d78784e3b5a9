"""Data sets from models: views and voxels, folder layouts, splits, broken models, interruption, the command."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.many.engines import Done, Local
from neural_renderer.apps.many.progress import Watching
from neural_renderer.apps.reconstruct.data.arrays import open_split
from neural_renderer.apps.reconstruct.data.dataset import Settings, assemble, make_object, make_objects
from neural_renderer.apps.reconstruct.data.models_folder import Model, default_splits, find_models, read_splits
from neural_renderer.apps.reconstruct.evaluation.check_axes import check_axes
from neural_renderer.apps.reconstruct.evaluation.sheets import data_sheet
from neural_renderer.metrics import silhouette_iou
from tests.programs import search_path

SMALL = Settings(samples=2)


def write_wedge(path: Path, turn: float = 0.0) -> None:
    """Write an asymmetric object far from the origin: red, long along +x, pointed towards +z."""
    vertices = torch.tensor([[0, 0, 0], [4, 0, 0], [0, 0, 2], [0, 1.5, 0], [4, 0.5, 0.0]]) * 3 + 100 + turn
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [1, 4, 2], [2, 4, 3], [0, 3, 1], [1, 3, 4]])
    textures = torch.zeros(6, 2, 2, 2, 3) + torch.tensor([0.9, 0.1, 0.1])
    path.parent.mkdir(parents=True, exist_ok=True)
    nr.save_mesh(path, vertices, faces, textures)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    folder = tmp_path / "models"
    for index in range(3):
        write_wedge(folder / "wedge" / f"w{index}.obj", 0.1 * index)
    nr.save_obj(folder / "ball" / "big.obj", *nr.icosphere(1))
    return folder


def test_views_are_those_of_a_camera_around_the_model(tmp_path: Path) -> None:
    write_wedge(tmp_path / "a" / "w.obj")
    images, voxels = make_object(tmp_path / "a" / "w.obj", SMALL)
    assert images.shape == (24, 4, 64, 64) and images.dtype == torch.uint8 and voxels.shape == (32, 32, 32)
    mesh = nr.Mesh.load(tmp_path / "a" / "w.obj").normalize()
    turn = torch.arange(24) * 15 * torch.pi / 180
    level, height = 2.732 * 3**0.5 / 2, 2.732 / 2
    eye = torch.stack((level * turn.cos(), torch.full((24,), height), level * turn.sin()), 1)
    camera = nr.Camera.look_at(eye, viewing_angle=15)
    alpha = nr.render((mesh.vertices.detach() / 2, mesh.faces), camera, 64, outputs="alpha").alpha
    assert alpha is not None
    assert (alpha - images[:, 3].float() / 255).abs().mean() < 3e-3  # the same from every side, and not mirrored
    assert silhouette_iou(alpha.flip(2), images[:, 3].float() / 255).mean() < 0.9


def test_colours_are_lit_and_not_multiplied_by_alpha(tmp_path: Path) -> None:
    write_wedge(tmp_path / "a" / "w.obj")
    images = make_object(tmp_path / "a" / "w.obj", SMALL)[0].float() / 255
    red, green, blue, alpha = images.unbind(1)
    edge, inside = (alpha > 0) & (alpha < 1), alpha == 1
    assert edge.any() and not images[:, :3].amax(1)[alpha == 0].any()
    for where in (edge, inside):
        assert red[where].min() > 0.35 and red[where].max() > 0.8  # lit from everywhere, nowhere black
        assert torch.allclose(green[where] / red[where], torch.tensor(0.172 / 0.908), atol=0.02)
    assert (green - blue).abs().max() < 1.5 / 255  # channels may be rounded apart: at most one level of uint8


def test_voxels_stand_where_the_views_show_them(models: Path, tmp_path: Path) -> None:
    found, _ = find_models(models)
    assert all(problem is None for _, problem, _ in make_objects(found, tmp_path / "d", SMALL, Local(0)))
    assemble(tmp_path / "d", {"test": {"wedge": [m for m in found if m.category == "wedge"]}}, SMALL, {})
    split = open_split(tmp_path / "d", "test")
    fit, axes = check_axes(split, "wedge")
    assert fit > 0.7 and axes is None
    for axis, name in enumerate(("(-0, 1, 2)", "(0, -1, 2)", "(0, 1, -2)")):
        turned = replace(split, voxels={"wedge": np.flip(split.voxels["wedge"], 1 + axis).copy()})
        fit, axes = check_axes(turned, "wedge")
        assert fit < 0.7 and axes == name, fit
    turned = replace(split, voxels={"wedge": np.transpose(split.voxels["wedge"], (0, 2, 3, 1)).copy()})
    assert check_axes(turned, "wedge")[1] == "(2, 0, 1)"
    assert data_sheet(split, "wedge").shape == (3, 3 * 64, 10 * 64)


def test_an_object_without_colour_is_grey(tmp_path: Path) -> None:
    nr.save_obj(tmp_path / "ball.obj", *nr.icosphere(2))
    images, voxels = make_object(tmp_path / "ball.obj", SMALL)
    rgb = images[:, :3, 32, 32].float()
    assert (rgb.amax(1) == rgb.amin(1)).all() and 80 < rgb.min() < rgb.max() < 220
    assert 12000 < voxels.sum() < 20000


def test_layouts(tmp_path: Path) -> None:
    write_wedge(tmp_path / "chair" / "a.obj")
    write_wedge(tmp_path / "chair" / "a.glb")
    write_wedge(tmp_path / "02691156" / "1a04" / "model.obj")
    write_wedge(tmp_path / "02691156" / "1b05" / "models" / "model_normalized.obj")
    write_wedge(tmp_path / "02691156" / "1c06" / "only.ply")
    (tmp_path / "02691156" / "1d07").mkdir()
    (tmp_path / "02691156" / "1d07" / "screenshot.png").touch()
    write_wedge(tmp_path / "02691156" / "1e08" / "x.obj")
    write_wedge(tmp_path / "02691156" / "1e08" / "y.obj")
    (tmp_path / "LICENSES").mkdir()
    (tmp_path / "LICENSES" / "text.txt").touch()
    found, broken = find_models(tmp_path)
    names = [f"{model.category}/{model.name} {model.path.name}" for model in found]
    assert names == [
        "02691156/1a04 model.obj",
        "02691156/1b05 model_normalized.obj",
        "02691156/1c06 only.ply",
        "chair/a a.obj",
    ]
    assert list(broken) == ["02691156/1d07", "02691156/1e08"]
    assert "expected a mesh, got none" in broken["02691156/1d07"] and "x.obj, y.obj" in broken["02691156/1e08"]


def test_splits(tmp_path: Path) -> None:
    path = tmp_path / "splits.csv"
    path.write_text("id,synsetId,subSynsetId,modelId,split\n1,02691156,x,aa,train\n\n2,02691156,x,bb,VALID\n")
    assert read_splits(path) == {("02691156", "aa"): "train", ("02691156", "bb"): "val"}
    for text, sentence in (
        ("", "expected a column 'category', got an empty file"),
        ("category,model\n", "expected a column 'split'"),
        ("category,model,split\na,b\n", "line 2: expected 3 columns, got 2"),
        ("category,model,split\na,b,c\n", "line 2: expected a split of train, val, test, got 'c'"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=sentence):
            read_splits(path)


def test_default_splits() -> None:
    models = [Model("a", str(index), Path("x")) for index in range(50)] + [Model("b", "one", Path("x"))]
    splits = default_splits(models)
    counts = [sum(value == name for (c, _), value in splits.items() if c == "a") for name in ("train", "val", "test")]
    assert counts == [35, 5, 10] and splits["b", "one"] == "train"
    assert default_splits(models[:50]) == {key: value for key, value in splits.items() if key[0] == "a"}


def command(models: Path, out: Path, *options: str) -> int:
    return cli.main(["reconstruct", "dataset", str(models), str(out), "--samples", "4", "-j", "0", *options])


def test_the_command_and_its_second_run(models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (models / "wedge" / "broken.obj").write_text("v 1 2\nf 1 2 3\n")
    (models / "wedge" / "flat.obj").write_text("v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n")
    table = tmp_path / "splits.csv"
    rows = [
        "wedge,w0,train",
        "wedge,w1,test",
        "wedge,broken,test",
        "wedge,flat,test",
        "ball,big,test",
        "ball,lost,test",
    ]
    table.write_text("\n".join(["category,model,split", *rows]))
    out = tmp_path / "out"
    assert command(models, out, "--splits", str(table)) == 0
    told = capsys.readouterr()
    assert "broken.obj" in told.err and "flat.obj: vertices: expected vertices that differ" in told.err
    assert "3 models are left out" in told.out and "1 models are not in" in told.out
    description = json.loads((out / "dataset.json").read_text())
    assert description["names"] == {
        "train": {"wedge": ["w0"]},
        "val": {},
        "test": {"ball": ["big"], "wedge": ["w1"]},
    }
    assert sorted(description["broken"]) == ["ball/lost", "wedge/broken", "wedge/flat"]
    assert description["settings"]["views"] == 24 and description["versions"]["neural_renderer"] == nr.__version__
    split = open_split(out, "test")
    assert split.classes == ("ball", "wedge") and split.names["wedge"] == ("w1",)
    assert (out / "sheets" / "wedge_test.png").is_file()

    # The second run adds new models and keeps finished ones.
    made = {path: path.stat().st_mtime_ns for path in (out / "objects").rglob("*.npz")}
    write_wedge(models / "wedge" / "w3.obj")
    table.write_text("category,model,split\nwedge,w1,test\nwedge,w3,test\n")
    assert command(models, out, "--splits", str(table)) == 0
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in made.items())
    names = json.loads((out / "dataset.json").read_text())["names"]
    assert names["test"] == {"ball": ["big"], "wedge": ["w1", "w3"]} and names["train"] == {"wedge": ["w0"]}
    assert len(open_split(out, "test").images["wedge"]) == 2


def test_changed_models_are_rendered_again(models: Path, tmp_path: Path) -> None:
    found = [Model("ball", "big", models / "ball" / "big.obj")]
    path = tmp_path / "objects" / "ball" / "big.npz"
    list(make_objects(found, tmp_path, SMALL, Local(0)))
    first = path.read_bytes()
    list(make_objects(found, tmp_path, Settings(samples=1), Local(0)))
    second = path.read_bytes()
    write_wedge(found[0].path)
    list(make_objects(found, tmp_path, Settings(samples=1), Local(0)))
    assert len({first, second, path.read_bytes()}) == 3
    whole = path.read_bytes()
    spoilt = bytearray(whole)
    spoilt[len(whole) // 2] ^= 255  # where the images are
    path.write_bytes(spoilt)
    with pytest.raises(ValueError, match=r"big\.npz: expected a finished object, got a broken file"):
        assemble(tmp_path, {"test": {"ball": found}}, SMALL, {})
    assert not list(tmp_path.glob("*.npz"))
    path.write_bytes(second[:100])
    list(make_objects(found, tmp_path, Settings(samples=1), Local(0)))
    assert np.load(path)["images"].shape == (24, 4, 64, 64)


def test_images_in_a_sibling_folder(models: Path, tmp_path: Path) -> None:
    """Images outside, as in ShapeNetCore.v2: objects finished with them differ from objects finished without."""
    path = models / "ball" / "big.obj"
    path.write_text("mtllib ../paint.mtl\nusemtl paint\n" + path.read_text())
    (models / "paint.mtl").write_text("newmtl paint\nKd 0.1 0.9 0.1\n")
    found = [Model("ball", "big", path)]
    [(_, problem, _)] = make_objects(found, tmp_path, SMALL, Local(0))
    assert problem is not None and "allow_outside=True" in problem
    [(_, problem, notes)] = make_objects(found, tmp_path, SMALL, Local(0), allow_outside=True)
    assert problem is None and not notes
    [(_, problem, _)] = make_objects(found, tmp_path, SMALL, Local(0))
    assert problem is not None


def test_changed_materials_and_their_warnings(models: Path, tmp_path: Path) -> None:
    path = models / "ball" / "big.obj"
    path.write_text("mtllib paint.mtl\nusemtl paint\n" + path.read_text())
    found = [Model("ball", "big", path)]

    def made() -> tuple[float, list[str]]:
        [(_, problem, notes)] = make_objects(found, tmp_path, SMALL, Local(0))
        assert problem is None
        with np.load(tmp_path / "objects" / "ball" / "big.npz") as arrays:
            return float(arrays["images"][:, 0].mean()), notes

    grey, notes = made()
    assert notes and "paint.mtl" in notes[0]
    assert made() == (grey, notes)  # warnings of a finished object are repeated
    (path.parent / "paint.mtl").write_text("newmtl paint\nKd 0.1 0.9 0.1\n")
    green, notes = made()
    assert green < 0.7 * grey and not notes


def test_an_object_is_in_one_split(models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert command(models, out, "--set", "test") == 0
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.npz")}
    capsys.readouterr()
    assert command(models, out, "--set", "train") == 1
    told = capsys.readouterr().err
    assert "expected ball/big in the split train, got it in test from an earlier run" in told
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.npz")} == before


def hook_workers(monkeypatch: pytest.MonkeyPatch, folder: Path, code: str) -> None:
    """Make worker processes run ``code`` when they open the model w1.obj.

    A worker is a new interpreter, which this test can reach through environment variables only.
    """
    (folder / "sitecustomize.py").write_text(
        "import os, sys, time\n"
        "def hook(event, args):\n"
        f"    if event == 'open' and str(args[0]).endswith('w1.obj'):\n        {code}\n"
        "sys.addaudithook(hook)\n"
    )
    monkeypatch.setenv("PYTHONPATH", search_path(folder))


@pytest.mark.slow
def test_workers_end_with_their_parent(models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Worker and parent share a pipe, which closes when both have ended."""
    hook_workers(monkeypatch, tmp_path, "os.write(1, b'here\\n'); time.sleep(3600)")
    arguments = ["reconstruct", "dataset", str(models), str(tmp_path / "out"), "-j", "1"]
    command = [sys.executable, "-m", "neural_renderer", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as parent:
        assert parent.stdout is not None and parent.stdout.readline() == b"here\n"
        parent.kill()
        assert parent.stdout.read() == b""


@pytest.mark.slow
def test_a_process_that_dies_costs_one_model(models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (models / "wedge" / "w1.obj").write_text("v 0 0 0\n" * 10)
    hook_workers(monkeypatch, tmp_path, "os._exit(9)")
    found, _ = find_models(models)
    results = {model.name: problem for model, problem, _ in make_objects(found, tmp_path / "out", SMALL, Local(1))}
    assert results.pop("w1") is not None and set(results.values()) == {None} and len(results) == 3


def test_interrupted(
    models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C ends the command at once: finished objects stay, also where a worker hangs."""
    out, hook = tmp_path / "out", Watching.__call__
    hook_workers(monkeypatch, tmp_path, "time.sleep(3600)")

    def press(watching: Watching, worker: str, done: Done) -> None:
        hook(watching, worker, done)
        if watching.total.models == 2:
            signal.raise_signal(signal.SIGINT)  # Python runs its handler in the main thread

    monkeypatch.setattr(Watching, "__call__", press)
    assert command(models, out, "-j", "1") == 130
    told = capsys.readouterr()
    assert "the same command continues" in told.out and "Traceback" not in told.err
    assert sorted(file.stem for file in out.glob("objects/*/*.npz")) == ["big", "w0"] and not list(out.glob("*.npz"))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--set", "test", "--splits", "x.csv"], "--set: expected only one of --set and --splits, got both"),
        (["--splits", "nowhere.csv"], "nowhere.csv: expected a file, got nothing there"),
        (["--samples", "1"], "--samples: expected at least 4, got 1"),
        (["--views", "0"], "--views: expected at least 1, got 0"),
    ],
)
def test_bad_options(
    models: Path, tmp_path: Path, options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(models, tmp_path / "out", *options) == 1
    told = capsys.readouterr().err
    assert sentence in told and told.count("\n") == 1 and not (tmp_path / "out").exists()


def test_bad_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    for name, sentence in (
        ("nowhere", "nowhere: expected a folder with a folder of models per category, got nothing there"),
        ("file", "got a file"),
        ("empty", "expected category/model.obj or category/model/model.obj, got no such mesh file"),
    ):
        assert command(tmp_path / name, tmp_path / "out") == 1
        assert sentence in capsys.readouterr().err
    (tmp_path / "models" / "a").mkdir(parents=True)
    (tmp_path / "models" / "a" / "b.obj").write_text("nothing")
    assert command(tmp_path / "models", tmp_path / "out", "--set", "test") == 1
    assert "expected at least one model that can be rendered, got none" in capsys.readouterr().err


def test_a_full_disk_ends_the_run_and_names_the_file(
    models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numpy.savez_compressed", full)
    assert command(models, tmp_path / "out") == 1
    told = capsys.readouterr().err
    assert "big.npz: expected to write it, got: No space left on device" in told
    assert not list((tmp_path / "out").rglob("*.npz*"))


def test_real_models(shared: Path) -> None:
    """A car with holes and a textured chair: seen from all sides, whole, and the same in voxels and in views."""
    for name in ("car/gazebo__prius_hybrid.obj", "chair/aws_smallhouse__ChairA_01.obj"):
        images, voxels = make_object(shared / "data" / "models" / name, Settings(views=6, samples=2))
        alpha = images[:, 3] > 127
        assert 300 < alpha.sum((1, 2)).min() < alpha.sum((1, 2)).max() < 2000
        assert not alpha[:, 0].any() and not alpha[:, :, -1].any()
        assert voxels.any((1, 2)).sum() >= 8 and 1000 < voxels.sum() < 6000
