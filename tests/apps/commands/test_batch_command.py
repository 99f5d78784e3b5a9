"""The command `batch`: rows of tables as runs, failures, interruption, tables and sheets of results."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.finish import command as finish_command
from neural_renderer.apps.fit import Views
from neural_renderer.apps.many.commands.jobs import DoJob, Job, entry_file, read_jobs
from neural_renderer.apps.many.commands.results import write_table
from neural_renderer.apps.many.engines import Done
from neural_renderer.apps.many.progress import Watching
from neural_renderer.io.atomic_write import write_file
from tests.apps.edit.networks import saved_vgg
from tests.apps.many.jobs import watched_ray

COLUMNS = "images,name,steps,cells,texture_steps,turntable,batch\n"


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    """A table of three fits, of which one has no cameras."""
    eyes = nr.get_points_from_angles(3.0, torch.tensor([70.0, 10, -35, 20]), torch.arange(4) * 90.0)
    vertices, faces = nr.icosphere(1)
    for number in range(2):
        mesh = nr.Mesh(vertices * torch.tensor([0.9, 0.5 + 0.2 * number, 0.7]), faces)
        camera = nr.Camera.look_at(eyes, viewing_angle=22.0)
        views = Views.of(mesh, camera, 32)
        rows = []
        for index in range(4):
            picture = torch.cat((views.photos[index], views.masks[index][None]))  # type: ignore[index]
            nr.save_image(tmp_path / f"scan {number}" / f"{index}.png", picture)
            matrix = torch.eye(4)
            right, up, forward = camera.rotation[index]
            matrix[:3] = torch.stack((right, up, -forward, camera.origin[index]), 1)
            rows.append({"file_path": f"./{index}", "transform_matrix": matrix.tolist()})
        about = {"camera_angle_x": np.radians(44), "frames": rows}
        (tmp_path / f"scan {number}" / "transforms.json").write_text(json.dumps(about))
    (tmp_path / "empty").mkdir()
    table = tmp_path / "scans.csv"
    table.write_text(COLUMNS + "scan 0,,2,16,2,0,2\nscan 1,,2,16,2,0,2\nempty,,2,16,2,0,2\n")
    return table


def batch(table: Path, out: Path, *options: str) -> int:
    return cli.main(["batch", "fit", str(table), "-o", str(out), *options])


@pytest.mark.slow
def test_fits(scans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert batch(scans, out, "-j", "1") == 0
    assert "1 of 3 jobs failed" in capsys.readouterr().err
    with (out / "reports.csv").open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert {name: row["state"] for name, row in rows.items()} == {
        "scan_0": "finished",
        "scan_1": "finished",
        "empty": "failed",
    }
    assert 0 < float(rows["scan_0"]["fitted.iou.mean"]) <= 1 and "empty" in rows["empty"]["problem"]
    assert json.loads((out / "failed.jsonl").read_text())["name"] == "empty"
    assert np.asarray(Image.open(out / "sheet.png")).shape == (2 * 160, 6 * 160, 3)
    assert (out / "scan_0" / "log.txt").read_text()
    meshes = {path: path.stat().st_mtime_ns for path in out.rglob("mesh.obj")}
    with scans.open("a") as file:
        file.write("scan 0,again,2,16,2,0,2\n")
    assert batch(scans, out, "-j", "0") == 0  # finished runs are kept
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in meshes.items())
    assert (out / "again" / "mesh.obj").read_bytes() == (out / "scan_0" / "mesh.obj").read_bytes()
    first = (out / "scan_0" / "mesh.obj").read_bytes()
    (out / "scan_0" / "mesh.obj").unlink()
    scans.write_text(scans.read_text().replace("empty,,", "scan 1,empty,"))
    assert batch(scans, out, "-j", "0") == 0  # lost results, and failures with other arguments, are made again
    assert (out / "scan_0" / "mesh.obj").read_bytes() == first
    assert (out / "failed.jsonl").read_text() == "" and (out / "empty" / "mesh.obj").is_file()
    scans.write_text(COLUMNS + "scan 0,,3,16,2,0,2\n")
    assert batch(scans, out, "-j", "0") == 1
    assert "expected scan_0 with the arguments of an earlier run" in capsys.readouterr().err


def test_interrupted(scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hook = Watching.__call__

    def press(watching: Watching, worker: str, done: Done) -> None:
        hook(watching, worker, done)
        if watching.total.models == 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Watching, "__call__", press)
    assert batch(scans, tmp_path / "out", "-j", "0") == 130
    assert not list((tmp_path / "out" / "manifest").glob("scan_1*")) and not (tmp_path / "out" / "reports.csv").exists()


def test_styles_and_rows(tmp_path: Path) -> None:
    nr.save_obj(tmp_path / "ball.obj", *nr.icosphere(1))
    Image.fromarray(np.full((32, 40, 3), 90, np.uint8)).save(tmp_path / "painting.png")
    weights = saved_vgg(tmp_path)
    table = tmp_path / "styles.csv"
    table.write_text(
        "name,mesh,painting,weights,steps,size,batch,turntable,seamless,light\n"
        f"x,ball.obj,painting.png,{weights},1,32,1,0,no,0.5 0.5\n"
    )
    home = str(tmp_path.resolve())
    assert read_jobs(table, "style") == [
        Job(
            "x",
            (f"{home}/ball.obj", f"{home}/painting.png", "--weights", str(weights), "--steps", "1", "--size", "32")
            + ("--batch", "1", "--turntable", "0", "--seamless", "False", "--light", "0.5", "0.5"),
        )
    ]
    assert cli.main(["batch", "style", str(table), "-o", str(tmp_path / "out"), "-j", "0"]) == 0
    assert (tmp_path / "out" / "x" / "views.png").is_file()


@pytest.mark.parametrize("engine", ["local", pytest.param("ray", marks=pytest.mark.slow)])
def test_finishes(engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("_SHEET_VIEWS", 1), ("_SHEET_SIZE", 32)):  # in this process; those of Ray draw it whole
        monkeypatch.setattr(finish_command, name, value)
    for number in range(2):
        nr.save_obj(tmp_path / f"ball{number}.obj", *nr.icosphere(1 + number))
    table = tmp_path / "balls.csv"
    table.write_text("mesh,faces,size,steps\nball0.obj,20 12,32,0\nball1.obj,40,32,0\n")
    with watched_ray(engine == "ray"):
        options = ("--engine", engine, "-j", "2" if engine == "ray" else "0")
        assert cli.main(["batch", "finish", str(table), "-o", str(tmp_path / "out"), *options]) == 0
    counts = {file.parent.name + file.stem: nr.UVMesh.load(file).num_faces for file in tmp_path.glob("out/*/*.glb")}
    assert counts == {"ball0mesh_20": 20, "ball0mesh_12": 12, "ball1mesh": 40}
    with (tmp_path / "out" / "reports.csv").open() as file:
        assert [row["state"] for row in csv.DictReader(file)] == ["finished", "finished"]


def test_renamed_jobs_are_told(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("images,name\nscan 1,\na,v1.2\n")
    with pytest.warns(UserWarning, match="got others; 'v1.2 is v1_2'"):
        assert [job.name for job in read_jobs(tmp_path / "t.csv", "fit")] == ["scan_1", "v1_2"]
    (tmp_path / "t.csv").write_text(f"images,name\na,{'n' * 300}\nb,{'n' * 301}\n")
    with pytest.warns(UserWarning, match="got others"):  # a name is that of a folder, and of an entry
        first, second = (job.name for job in read_jobs(tmp_path / "t.csv", "fit"))
    assert first != second and max(len(first), len(second)) <= 200


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "expected a header and one row or more, got none"),
        ("images,gold\na,1\n", "expected columns name, .*, got 'gold'"),
        ("images,output\na,1\n", "got 'output'"),
        ("steps\n3\n", "line 2: expected a value in the column 'images', got none"),
        ("images,steps\n\na,1,2\n", "line 3: expected 2 columns, got 3"),
        ("images,name\na,manifest\n", "line 2: expected another name, got 'manifest'"),
        ("images,name\na,x\nb,x\n", "expected names that differ, got 'x' twice"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ValueError, match=sentence):
        read_jobs(tmp_path / "t.csv", "fit")


def test_wrong_options_fail_alone(scans: Path, tmp_path: Path) -> None:
    scans.write_text("images,steps\nscan 0,many\n")
    assert batch(scans, tmp_path / "out", "-j", "0") == 1  # all failed
    [row] = [json.loads(line) for line in (tmp_path / "out" / "failed.jsonl").read_text().splitlines()]
    assert "expected options of fit" in row["problem"] and "many" in row["problem"] and row["problem"].isascii()


def test_a_report_does_not_replace_name_and_state(tmp_path: Path) -> None:
    job = Job("a", ())
    write_file(tmp_path / "a" / "report.json", json.dumps({"name": "x", "state": "y", "steps": 3}))
    write_file(entry_file(tmp_path, job), json.dumps({"arguments": [], "problem": None, "code": 0}))
    assert write_table(tmp_path, [job]) == 0
    assert (tmp_path / "reports.csv").read_text() == "name,state,problem,steps\na,finished,,3\n"


def test_a_log_is_not_written_through_a_link(tmp_path: Path) -> None:
    """The folder may come from others."""
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "out" / "a").mkdir(parents=True)
    (tmp_path / "out" / "a" / "log.txt").symlink_to(tmp_path / "mine.txt")
    with pytest.raises(ValueError, match="expected options of fit"):
        DoJob(tmp_path / "out", "fit")._run(Job("a", ("x", "--steps", "many")))
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert "many" in (tmp_path / "out" / "a" / "log.txt").read_text()
