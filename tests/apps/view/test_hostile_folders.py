"""Folders of results that come from strangers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.view.results import read_results

CAMERA = {"eye": [0, 0, -3], "direction": [0, 0, 1], "up": [0, 1, 0], "viewing_angle": 20}


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    nr.Mesh.icosphere(0).save(tmp_path / "secret.obj")
    nr.save_image(tmp_path / "secret.png", torch.rand(8, 8, 4))
    nr.Mesh.icosphere(1).save(tmp_path / "out" / "mesh.obj")
    return tmp_path


def inputs(secret: Path) -> list[dict[str, Any]]:
    """What a report may call its inputs, by absolute paths, by names that lead out, and by those of other machines."""
    mesh, picture = str(secret / "secret.obj"), str(secret / "secret.png")
    network = "//192.0.2.1/share/secret.obj"
    return [
        {"mesh": mesh},
        {"mesh": str(secret / "out" / ".." / "secret.obj")},
        {"mesh": network},
        {"mesh": network.replace("/", "\\") if Path("a\\b").name == "b" else network},
        {"images": picture},
        {"images": str(secret)},
        {"painting": picture},
        {"image": picture},
    ]


def test_a_report_opens_no_file_outside_of_its_folder(secret: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does it ask whether there is one."""
    asked: list[str] = []
    for method in ("stat", "open", "is_file", "exists"):
        before = getattr(Path, method)
        monkeypatch.setattr(
            Path, method, lambda self, *a, before=before, **k: (asked.append(str(self)), before(self, *a, **k))[1]
        )
    for given in inputs(secret):
        (secret / "out" / "report.json").write_text(json.dumps({"inputs": given, "camera": CAMERA}))
        results = read_results(secret / "out")
        assert list(results.meshes) == ["result"] and results.views is None and not results.pictures
        assert len(results.notes) == 1 and "allow_outside=True shows it" in results.notes[0]
    assert not [path for path in asked if "secret.obj" in path or "secret.png" in path]


def test_a_record_has_nothing_from_outside(secret: Path) -> None:
    (secret / "out" / "report.json").write_text(json.dumps({"inputs": {"mesh": str(secret / "secret.obj")}}))
    command = ["view", str(secret / "out"), "--no-browser", "--record"]
    pytest.importorskip("viser")
    assert cli.main([*command, str(secret / "a.html")]) == 0
    assert cli.main([*command, str(secret / "b.html"), "--allow-outside"]) == 0
    assert '"before"' not in (secret / "a.html").read_text() and '"before"' in (secret / "b.html").read_text()


def test_names_are_relative_to_the_folder(secret: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(secret)
    for name, file in (("mesh", "secret.obj"), ("painting", "secret.png")):
        (secret / "out" / "report.json").write_text(json.dumps({"inputs": {name: file}}))
        results = read_results(Path("out"))
        assert list(results.meshes) == ["result"] and not results.pictures


@pytest.mark.parametrize("reasons", [None, 3, "x", [1, {"text": "why"}], [{}], {"text": "y"}])
def test_reasons_of_any_kind(secret: Path, reasons: Any) -> None:
    (secret / "out" / "report.json").write_text(json.dumps({"verdict": "doubtful", "reasons": reasons}))
    assert read_results(secret / "out").notes[0].startswith("doubtful: ")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"inputs":' + '{"a":' * 100_000, '{"history":[{"loss":' + "9" * 5000 + "}]}"]
)
def test_reports_that_no_parser_takes(secret: Path, text: str) -> None:
    (secret / "out" / "report.json").write_text(text)
    assert "report.json: expected the report of a command" in read_results(secret / "out").notes[0]


@pytest.mark.parametrize("value", [5, ["secret.obj"], {"a": 1}, "x" * 100_000, "a\x1b[31m\n", "\u202e"])
def test_names_and_cameras_of_any_kind(secret: Path, value: Any) -> None:
    """Notes are short, have no control characters, and none of Python's words."""
    images, known = str(secret / "out" / "a.png"), {"inputs": {"mesh": value, "painting": value}}
    nr.save_image(images, torch.rand(8, 8, 4))
    for report in (known, {"inputs": {"images": images}, "camera": CAMERA | {"eye": value}}):
        (secret / "out" / "report.json").write_text(json.dumps(report))
        results = read_results(secret / "out")
        assert "result" in results.meshes and results.notes
        for note in results.notes:
            assert "expected" in note and "object" not in note and len(note) < 600 and note.isprintable()


def test_files_in_the_folder_are_shown(secret: Path) -> None:
    nr.Mesh.icosphere(0).save(secret / "out" / "in" / "start.obj")
    report = {"inputs": {"mesh": str(secret / "out" / "in" / "start.obj")}}
    (secret / "out" / "report.json").write_text(json.dumps(report))
    results = read_results(secret / "out")
    assert set(results.meshes) == {"before", "result"} and not results.notes


@pytest.mark.parametrize("goal", ["../secret.png", "..", "a/../../secret.png"])
def test_links_out_of_a_folder_are_refused(goal: str, secret: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At any depth; those inside of it are followed, and so is the folder itself."""
    out = secret / "out"
    (out / "a" / "b").mkdir(parents=True)
    (out / "a" / "b" / "inner.png").symlink_to(out / "mesh.obj")
    (secret / "link").symlink_to(out)
    assert "mesh" in read_results(secret / "link").meshes
    (out / "a" / "b" / "x.png").symlink_to(secret / "out" / goal)
    with pytest.raises(ValueError, match=r"out: expected files of its own, got the link 'a.b.x.png', which leads"):
        read_results(out)
    assert "mesh" in read_results(out, allow_outside=True).meshes
    assert cli.main(["view", str(out), "--no-browser", "--record", str(secret / "a.html")]) == 1
    assert "--allow-outside follows it" in capsys.readouterr().err
