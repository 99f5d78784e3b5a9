"""`view`, and --view and --record of other commands: what is written, what may be changed, and who may stop what."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.observer import Knob
from neural_renderer.apps.common.options import WatchOptions
from neural_renderer.apps.common.task_runner import TaskRunner
from neural_renderer.apps.fit import MeshFit, Views
from neural_renderer.apps.view.records.replay import Record
from neural_renderer.apps.view.results import read_results
from neural_renderer.apps.view.watching import watching
from tests.apps.commands.test_fit_command import SMALL, folder, originals, thing
from tests.paths import EXAMPLES, ROOT

__all__ = ["folder", "originals"]


class Watcher:
    """An observer that pauses, stops or changes something at some step."""

    def __init__(self, stop_at: int = 10**9, changes: dict[str, Any] | None = None) -> None:
        self.steps: list[tuple[str, int]] = []
        self.offered: list[list[str]] = []
        self._stop_at, self._changes = stop_at, changes or {}
        self.paused = False

    @property
    def stopped(self) -> bool:
        return len(self.steps) >= self._stop_at

    def observe(
        self, phase: str, step: int, steps: int, numbers: Mapping[str, float], mesh: Callable[[], Any], /
    ) -> None:
        assert 1 <= step <= steps and numbers["loss"] >= 0 and isinstance(mesh(), nr.Mesh)
        self.steps.append((phase, step))

    def offer(self, knobs: Sequence[Knob], /) -> None:
        self.offered.append([knob.name for knob in knobs])

    def changes(self) -> dict[str, Any]:
        changes, self._changes = self._changes, {}
        return changes


def run(tmp_path: Path, watcher: Watcher) -> tuple[TaskRunner, bool, MeshFit]:
    eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(4) * 90.0)
    views = Views.of(thing(), nr.Camera.look_at(eyes, viewing_angle=22), 32)
    fit = MeshFit(views, cells=16, steps=4, texture_steps=2)
    runner = TaskRunner(tmp_path, fit, {}, lambda path: None, 1000, observer=watcher, mesh=fit.mesh)
    return runner, runner.run(False), fit


def test_every_step_is_seen(tmp_path: Path) -> None:
    watcher = Watcher(changes={"laplacian": 7.0})
    runner, finished, _ = run(tmp_path, watcher)
    assert finished and not runner.stopped
    assert watcher.steps == [*(("shape", step) for step in range(1, 5)), ("texture", 1), ("texture", 2)]
    assert watcher.offered[0][:2] == ["rate", "silhouette"] and watcher.offered[-1] == []
    assert runner.changes == [{"phase": "shape", "step": 1, "laplacian": 7.0}]


def test_stop_keeps_the_result(tmp_path: Path) -> None:
    runner, finished, fit = run(tmp_path, Watcher(stop_at=2))
    assert not finished and runner.stopped and fit.step == 2 and len(runner.history) == 2


def test_changes_that_do_not_fit_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runner, finished, _ = run(tmp_path, Watcher(changes={"laplacian": -1.0, "no": 3.0, "rate": "fast"}))
    err = capsys.readouterr().err
    assert finished and not runner.changes
    assert "laplacian: expected" in err and "got 'no'" in err and "rate: expected" in err


def test_settings_change_the_fit(tmp_path: Path) -> None:
    """A step size of nearly 0 stops the vertices."""
    eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(4) * 90.0)
    views = Views.of(thing(), nr.Camera.look_at(eyes, viewing_angle=22), 32)
    fit = MeshFit(views, cells=16, steps=4)
    fit.adjust("rate", 1e-9)
    before = fit.shape[0].clone()
    fit.advance()
    assert (fit.shape[0] - before).abs().max() < 1e-6
    fit.adjust("rate", 0.01)
    fit.advance()
    assert (fit.shape[0] - before).abs().max() > 1e-3


def test_a_fit_is_recorded_and_viewed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "out"
    record = out / "run.html"
    assert cli.main(["fit", str(folder), "-o", str(out), *SMALL, "--record", str(record), "--color-from", "0.5"]) == 0
    assert re.search(r"run\.html: \d+ frames?, \d\.\d MiB", capsys.readouterr().out.replace("\n", ""))
    report = json.loads((out / "report.json").read_text())
    assert report["inputs"]["images"] == str(folder.resolve()) and report["changes"] == []
    for image in folder.glob("r_*.png"):  # the folder has small copies of them
        image.unlink()
    results = read_results(out)
    assert results.record is not None and results.record.labels[-1] == "texture step 4"
    assert list(results.meshes) == ["result"] and len(results.views) == 6 and not results.notes
    assert set(results.numbers) == {"loss", "iou"} and "comparison.png" in results.pictures
    assert "mesh_texture.png" not in results.pictures
    # Without the copies the rest is shown, with a sentence.
    shutil.rmtree(out / "views")
    outside = read_results(out)
    assert outside.views is None and len(outside.notes) == 1 and "allow_outside=True shows it" in outside.notes[0]
    results = read_results(out, allow_outside=True)
    assert results.views is None and len(results.notes) == 1 and "r_0" in results.notes[0]
    assert cli.main(["view", str(out), "--no-browser", "--record", str(folder / "now.html")]) == 0
    assert len(Record(folder / "now.html")) == 1


@pytest.mark.parametrize(
    "how", ["Ctrl-C", *(pytest.param(how, marks=pytest.mark.slow) for how in ("stop and keep", "Ctrl-C twice"))]
)
def test_a_fit_that_is_ended_early_gets_its_texture(
    how: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its record ends with its last step, and --resume goes on with the shape."""
    out, whole = folder / "out", folder / "whole"
    arguments = ["fit", str(folder), *SMALL, "-o"]
    advance = MeshFit.advance

    def ended(fit: MeshFit) -> dict[str, float]:
        if how != "stop and keep" and (fit.phase, fit.step) == ("shape", 2):
            signal.raise_signal(signal.SIGINT)
        if how == "Ctrl-C twice" and (fit.phase, fit.step) == ("texture", 1):
            signal.raise_signal(signal.SIGINT)
        steps.append(fit.phase)
        return advance(fit)

    steps: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr(MeshFit, "advance", ended)
        if how == "stop and keep":
            patch.setattr("neural_renderer.apps.view.viewer.Viewer.stopped", property(lambda _: len(steps) >= 3))
        assert cli.main([*arguments, str(out), "--record", str(out / "run.html")]) == (130 if "Ctrl" in how else 0)
    assert steps == ["shape"] * 3 + ["texture"] * (2 if how == "Ctrl-C twice" else 4)
    told = capsys.readouterr().out
    assert "the texture of this shape follows; Ctrl-C leaves it out" in told
    assert "interrupted after 3 steps (--resume continues)" in told
    assert nr.Mesh.load(out / "mesh.obj").textures.std() > 0.05
    report = json.loads((out / "report.json").read_text())
    assert not report["finished"] and ("psnr" in report["fitted"])
    results = read_results(out)
    assert results.record is not None and results.record.labels[-1] == "shape step 3"
    assert cli.main([*arguments, str(out), "--resume"]) == 0 and cli.main([*arguments, str(whole)]) == 0
    assert (out / "mesh.obj").read_bytes() == (whole / "mesh.obj").read_bytes()


def test_a_pose_is_viewed(folder: Path) -> None:
    thing().save(folder / "thing.glb")
    arguments = ["pose", str(folder / "thing.glb"), str(folder / "r_0.png"), "-o", str(folder / "out")]
    record = ["--viewing-angle", "22", "--record", str(folder / "out" / "run.html")]
    assert cli.main([*arguments, *record]) == 0
    results = read_results(folder / "out", allow_outside=True)
    assert not results.notes and len(results.views) == 1
    assert results.record is not None and results.record.labels[-1] == "pose step 1"


def test_meshes_side_by_side(tmp_path: Path) -> None:
    data = EXAMPLES / "data"
    record = tmp_path / "both.html"
    command = ["view", str(data / "spot.obj"), str(data / "teapot.obj"), "--no-browser", "--record", str(record)]
    assert cli.main(command) == 0
    assert list(Record(record).meshes(0)) == ["spot", "teapot"]


def test_a_training_and_a_data_set_are_viewed(tmp_path: Path) -> None:
    (tmp_path / "trained").mkdir()
    (tmp_path / "trained" / "log.csv").write_text("step,loss,iou,val_iou\n1,0.5,0.2,\n2,0.25,,0.3\n")
    numbers = read_results(tmp_path / "trained").numbers
    assert numbers == {"loss": [(1, 0.5), (2, 0.25)], "iou": [(1, 0.2)], "val_iou": [(2, 0.3)]}
    (tmp_path / "data" / "sheets").mkdir(parents=True)
    nr.save_image(tmp_path / "data" / "sheets" / "chair.png", torch.rand(8, 8, 3))
    assert list(read_results(tmp_path / "data").pictures) == ["sheets/chair.png"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["none.obj"], "none.obj: expected a mesh, a record or a folder, got nothing there"),
        (["empty"], "empty: expected meshes, pictures, curves or a record, got none"),
        (["damaged"], "damaged/mesh.glb: cannot be read as GLB"),
        (["damaged/mesh.glb"], "damaged/mesh.glb: cannot be read as GLB"),
        (["page.html"], "path: expected a file that ends in"),
        (["cut.html"], "cut.html: expected a record, got a damaged one"),
        (["empty", "damaged"], "expected meshes"),
        (["good.obj", "--record", "good.obj"], "which is an input"),
        (["good.obj", "--record", "good.txt"], "--record: expected a name that ends in .html"),
    ],
)
def test_what_cannot_be_viewed(
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "mesh.glb").write_bytes(b"glTF and no more")
    (tmp_path / "damaged" / "report.json").write_text("{")
    (tmp_path / "page.html").write_text("<html></html>")
    (tmp_path / "cut.html").write_text('<script id="record" type="application/json">{"format')
    nr.Mesh.icosphere(1).save("good.obj")
    record = [] if "--record" in arguments else ["--record", "out.html"]
    assert cli.main(["view", *arguments, *record, "--no-browser"]) == 1
    assert sentence in " ".join(capsys.readouterr().err.split())


def test_viser_is_named_where_it_is_missing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    fit = ["fit", str(folder), "-o", str(folder / "out"), "--view"]
    for arguments in (["view", str(EXAMPLES / "data" / "teapot.obj")], fit):
        assert cli.main(arguments) == 1
        assert '(pip install "neural-renderer[view]")' in capsys.readouterr().err


@pytest.mark.slow
def test_ctrl_c_ends_both(folder: Path) -> None:
    """A fit with a page: Ctrl-C ends it, the results are there, and the port is free."""
    pytest.importorskip("viser")
    arguments = ["fit", str(folder), "-o", str(folder / "out"), *SMALL, "--steps", "100000", "--view", "--port", "0"]
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "neural_renderer", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        env=os.environ | {"NO_COLOR": "1", "COLUMNS": "200"},
    )
    killer = threading.Timer(300, process.kill)
    killer.start()
    try:
        lines = []
        for line in process.stdout:
            lines.append(line)
            if "open http://127.0.0.1:" in line:
                break
        threading.Timer(3.0, lambda: process.send_signal(signal.SIGINT)).start()
        rest = process.stdout.read()
        assert process.wait(60) == 130, rest
        assert "interrupted after" in rest and (folder / "out" / "mesh.glb").is_file()
        assert "viser" not in rest and "Traceback" not in rest
    finally:
        killer.cancel()
        process.kill()
        process.wait()
        process.stdout.close()


def test_no_port_is_opened_unasked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened = []
    monkeypatch.setattr("neural_renderer.apps.view.viewer.Viewer._open_page", lambda *_: opened.append(0))
    with watching(WatchOptions()) as viewer:
        assert viewer is None
    with watching(WatchOptions(record=tmp_path / "run.html")) as viewer:
        assert viewer is not None and viewer.url is None
    assert not opened
