"""`neural-renderer dataset`: whole shards, the same bytes from every engine and after every interruption."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.many.engines import Done
from neural_renderer.apps.many.progress import Watching
from tests.apps.many.jobs import watched_ray
from tests.faults import contents

OPTIONS = (
    "--size",
    "24",
    "--views",
    "2",
    "--outputs",
    "rgba.png",
    "depth.npy",
    "--models-per-shard",
    "2",
    "--index",
    "csv",
)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six models, two of which are broken."""
    folder = tmp_path_factory.mktemp("models")
    vertices, faces = nr.icosphere(0)
    for number in range(4):
        nr.save_mesh(folder / f"ball_{number}.ply", vertices * torch.tensor([1.0, 1 + number, 2.0]), faces)
    (folder / "a_broken.obj").write_text("v 1 2\nf 1 2 3\n")
    (folder / "flat.obj").write_text("v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n")
    return folder


def command(models: Path, out: Path, *options: str) -> int:
    return cli.main(["dataset", str(models), "-o", str(out), *OPTIONS, *options])


@pytest.fixture(scope="module")
def undisturbed(models: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of a run in one process that nothing disturbed."""
    out = tmp_path_factory.mktemp("undisturbed")
    assert command(models, out, "-j", "0") == 0
    return contents(out)


def test_what_is_there(models: Path, undisturbed: dict[str, bytes], tmp_path: Path) -> None:
    assert sorted(name for name in undisturbed if "/" not in name) == [
        "dataset.json",
        "failed.jsonl",
        "index.csv",
        "manifest.json",
    ]
    failed = [json.loads(line) for line in undisturbed["failed.jsonl"].splitlines()]
    assert [row["name"] for row in failed] == ["a_broken", "flat"]
    assert failed[0]["problem"] == "a_broken, line 1: cannot read 'v 1 2'"
    rows = list(csv.DictReader(undisturbed["index.csv"].decode().splitlines()))
    assert [row["sample"] for row in rows] == [f"ball_{model}_{view:03d}" for model in range(4) for view in range(2)]
    manifest = json.loads(undisturbed["manifest.json"])
    assert (manifest["models"], manifest["failed"], manifest["views"], len(manifest["shards"])) == (6, 2, 8, 3)
    for row in rows:  # an offset leads to the sample
        data = undisturbed[row["shard"]][int(row["offset"]) :][: int(row["bytes"])]
        (tmp_path / "one.tar").write_bytes(data)
        with tarfile.open(tmp_path / "one.tar") as tar:
            assert tar.getnames() == [f"{row['sample']}.{part}" for part in ("rgba.png", "depth.npy", "camera.json")]


@pytest.mark.usefixtures("copied_processes")
@pytest.mark.parametrize(
    "options",
    [
        pytest.param(("-j", "2"), id="processes"),
        pytest.param(("--engine", "ray", "-j", "2"), id="ray", marks=pytest.mark.slow),
    ],
)
def test_the_same_bytes_from_every_engine(
    models: Path, undisturbed: dict[str, bytes], tmp_path: Path, options: tuple[str, ...]
) -> None:
    with watched_ray("ray" in options):
        assert command(models, tmp_path, *options) == 0
    assert contents(tmp_path) == undisturbed


def test_the_same_bytes_from_parts(models: Path, undisturbed: dict[str, bytes], tmp_path: Path) -> None:
    assert command(models, tmp_path, "-j", "0", "--shard", "1/2") == 0
    assert not (tmp_path / "manifest.json").exists()
    assert command(models, tmp_path, "-j", "0", "--shard", "0/2") == 0
    assert contents(tmp_path) == undisturbed


@pytest.mark.slow
def test_killed_and_continued(models: Path, undisturbed: dict[str, bytes], tmp_path: Path) -> None:
    """A run that is killed after its first shard leaves that shard; the same command makes the rest, and no more."""
    arguments = ["dataset", str(models), "-o", str(tmp_path), *OPTIONS, "-j", "1"]
    with subprocess.Popen([sys.executable, "-m", "neural_renderer", *arguments], stderr=subprocess.DEVNULL) as run:
        while not list(tmp_path.glob("manifest/*.json")) and run.poll() is None:
            time.sleep(0.02)
        run.kill()
    made = {path: path.stat().st_mtime_ns for path in tmp_path.glob("shards/*.tar") if _entry(path).exists()}
    assert made
    cut = tmp_path / "shards" / "000000.tar"
    assert command(models, tmp_path, "-j", "0") == 0
    assert contents(tmp_path) == undisturbed
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in made.items())
    cut.write_bytes(cut.read_bytes()[:-1])
    assert command(models, tmp_path, "-j", "0") == 0
    assert contents(tmp_path) == undisturbed


def _entry(shard: Path) -> Path:
    return shard.parents[1] / "manifest" / f"{shard.stem}.json"


def test_interrupted(
    models: Path, undisturbed: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hook = Watching.__call__

    def press(watching: Watching, worker: str, done: Done) -> None:
        hook(watching, worker, done)
        if watching.total.models == 3:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Watching, "__call__", press)
    assert command(models, tmp_path, "-j", "0") == 130
    assert sorted(path.name for path in tmp_path.rglob("*.tar")) == ["000000.tar"]
    monkeypatch.undo()
    assert command(models, tmp_path, "-j", "0") == 0
    assert contents(tmp_path) == undisturbed


def test_folders(models: Path, tmp_path: Path) -> None:
    assert command(models, tmp_path, "-j", "0", "--layout", "folders") == 0
    first = contents(tmp_path)
    assert "models/ball_2/001.rgba.png" in first and "models/ball_2/001.camera.json" in first
    next(tmp_path.glob("manifest/000002.json")).unlink()
    (tmp_path / "models" / "ball_3" / "001.rgba.png").write_bytes(b"cut")
    assert command(models, tmp_path, "-j", "0", "--layout", "folders") == 0
    assert contents(tmp_path) == first
    shutil.rmtree(tmp_path / "models" / "ball_0")
    (tmp_path / "models" / "ball_1" / "000.rgba.png").unlink()
    assert command(models, tmp_path, "-j", "0", "--layout", "folders") == 0
    assert contents(tmp_path) == first


def test_in_the_folder_of_the_models(
    models: Path, undisturbed: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(models, tmp_path, dirs_exist_ok=True)
    for _ in range(2):  # views are no models
        assert command(tmp_path, tmp_path / "views", "-j", "0") == 0
    made = contents(tmp_path / "views")
    assert {name: made[name] for name in made if name.endswith(".tar")} == {
        name: undisturbed[name] for name in undisturbed if name.endswith(".tar")
    }
    capsys.readouterr()
    assert command(tmp_path, tmp_path, "-j", "0") == 1
    assert "--output: expected a folder without the models" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text on other systems")
def test_names_that_are_no_text(models: Path, tmp_path: Path) -> None:
    place = tmp_path / "in"
    shutil.copytree(models, place)
    for name in (b"good_\xff.ply", b"bad_\xff.obj"):
        source = "ball_0.ply" if name.startswith(b"good") else "a_broken.obj"
        shutil.copy(models / source, os.path.join(os.fsencode(place), name))
    assert command(place, tmp_path / "out", "-j", "0") == 0
    made = contents(tmp_path / "out")
    assert [json.loads(row)["name"] for row in made["failed.jsonl"].splitlines()] == ["a_broken", "bad__", "flat"]


def test_nothing_could_be_drawn(models: Path, tmp_path: Path) -> None:
    """The exit code says so; where one model is drawn, it is 0."""
    assert command(models / "a_broken.obj", tmp_path, "-j", "0") == 1
    assert (tmp_path / "failed.jsonl").read_text().count("\n") == 1
    assert json.loads((tmp_path / "manifest.json").read_text())["failed"] == 1


def test_parquet(models: Path, undisturbed: dict[str, bytes], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    assert command(models, tmp_path, "-j", "0", "--index", "parquet") == 0
    rows = [
        {key: str(value) for key, value in row.items()}
        for row in parquet.read_table(tmp_path / "index.parquet").to_pylist()
    ]
    assert rows == list(csv.DictReader(undisturbed["index.csv"].decode().splitlines()))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--shard", "2/2"], "--shard: expected I/N with I from 0 to N - 1, such as 3/64, got 2/2"),
        (["--shard", "x"], "--shard: expected I/N"),
        (["--address", "auto"], "--address: expected --engine ray, got --engine local"),
        (["--views", "0"], "--views: expected at least 1, got 0"),
        (["--outputs", "rgba"], "--outputs: expected some of rgba.png"),
        (["--elevation", "91"], "--elevation: expected a number above -90.001 and below 90.001, got 91"),
        (["--cameras", "nowhere.json"], "nowhere.json"),
        (["--time-limit", "-1"], "--time-limit: expected at least 0"),
    ],
)
def test_bad_options(
    models: Path, tmp_path: Path, options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(models, tmp_path / "out", "-j", "0", *options) == 1
    told = capsys.readouterr().err
    assert sentence in told and told.count("\n") == 1 and not (tmp_path / "out").exists()


def test_another_data_set_in_the_folder(models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(models, tmp_path, "-j", "0", "--shard", "0/3") == 0
    before = contents(tmp_path)
    assert command(models, tmp_path, "-j", "0", "--seed", "3") == 1
    assert "dataset.json: expected an earlier run with cameras" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_another_light_in_the_same_file(models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sky, cameras, out = tmp_path / "sky.png", tmp_path / "cameras.json", tmp_path / "out"
    options = ("-j", "0", "--shard", "0/3", "--environment", str(sky), "--cameras", str(cameras))
    nr.save_image(sky, torch.ones(3, 4, 8))
    nr.Camera.look_at(torch.tensor([[0.0, 0, 5]])).save(cameras)
    assert command(models, out, *options) == 0
    nr.save_image(sky, torch.zeros(3, 4, 8))
    assert command(models, out, *options) == 1
    assert "expected an earlier run with environment_sha256" in capsys.readouterr().err
    nr.save_image(sky, torch.ones(3, 4, 8))
    nr.Camera.look_at(torch.tensor([[0.0, 0, 6]])).save(cameras)
    assert command(models, out, *options) == 1
    assert "expected an earlier run with cameras_sha256" in capsys.readouterr().err
