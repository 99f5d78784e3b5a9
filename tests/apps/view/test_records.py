"""Records: what is written can be read, and the file stays below its limit."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.view.drawing.snapshot import take_snapshot
from neural_renderer.apps.view.records.recorder import BEGIN, END, Recorder
from neural_renderer.apps.view.records.replay import Record, is_record
from tests.paths import EXAMPLES


def test_frames_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "run.html"
    recorder = Recorder(path)
    sphere, cube = nr.Mesh.icosphere(2), nr.Mesh(*nr.cube(), face_colors=torch.rand(12, 3))
    for step in range(3):
        recorder.log(step, {"loss": 1.0 / (step + 1)})
        grown = sphere.vertices * (1 + step)
        recorder.add(step, {"sphere": take_snapshot((grown, sphere.faces)), "cube": take_snapshot(cube)}, "shape")
    assert re.fullmatch(rf"{re.escape(str(path))}: 3 frames, 0\.\d MiB", recorder.write())
    record = Record(path)
    assert record.labels == ["shape step 0", "shape step 1", "shape step 2"] and is_record(path)
    assert record.numbers == {"loss": [(0, 1.0), (1, 0.5), (2, 1 / 3)]}
    for step in range(3):
        meshes = record.meshes(step)
        found, expected = meshes["sphere"], sphere.vertices.detach() * (1 + step)
        assert torch.equal(found.faces, sphere.faces)
        # Coordinates have 2¹⁶ levels over the bounding box.
        assert (found.vertices - expected).abs().max() <= 2 * (1 + step) / (2**16 - 1) / 2 * 1.01
        colors = meshes["cube"].textures
        assert (colors.mean((1, 2, 3)) - cube.textures.detach()[:, 0, 0, 0]).abs().max() <= 1 / 255
        assert meshes["cube"].vertices.shape == (8, 3)  # where faces share vertices, the record does, too


def test_images_can_be_read(tmp_path: Path) -> None:
    spot = nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    recorder = Recorder(tmp_path / "spot.html")
    recorder.add(0, {"spot": take_snapshot(spot)})
    recorder.write()
    found = Record(tmp_path / "spot.html").meshes(0)["spot"].uv_mesh
    camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)
    images = [nr.render(mesh, camera, 128).rgb for mesh in (spot, found)]
    assert (images[0] - images[1]).abs().mean() < 1e-3  # JPEG, and outlines that moved by 2⁻¹⁷ of the mesh


def test_equal_parts_are_kept_once(tmp_path: Path) -> None:
    """Twenty frames of the same mesh are hardly larger than one."""
    mesh = take_snapshot(nr.UVMesh.load(EXAMPLES / "data" / "spot.obj"))
    sizes = []
    for count in (1, 20):
        recorder = Recorder(tmp_path / f"{count}.html")
        for step in range(count):
            recorder.add(step, {"mesh": mesh})
        recorder.write()
        sizes.append((tmp_path / f"{count}.html").stat().st_size)
    assert sizes[1] - sizes[0] < 20 * 700


@pytest.mark.parametrize("steps", [1, 2, 300])
def test_the_size_is_bounded(tmp_path: Path, steps: int) -> None:
    """Frames of noise, 24 kB each, do not fit; the first and the last one stay, evenly spaced others between."""
    path = tmp_path / "run.html"
    recorder = Recorder(path, limit=1.0)
    faces = torch.arange(3000).reshape(-1, 3)
    for step in range(steps):
        recorder.add(step, {"noise": take_snapshot((torch.rand(3000, 3), faces))})
    sentence = recorder.write()
    assert path.stat().st_size <= 2**20
    kept = [int(label.split()[-1]) for label in Record(path).labels]
    if steps < 300:
        assert kept == list(range(steps))
    else:
        assert "th update, to keep it below 1 MiB" in sentence and len(kept) >= 15
        assert kept[0] == 0 and kept[-1] >= 280
        assert len(set(np.diff(kept[1:-1]).tolist())) == 1


def test_a_mesh_larger_than_the_limit_is_left_out_and_told(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.html", limit=1.0)
    faces = torch.arange(300_000).reshape(-1, 3)
    recorder.add(0, {"noise": take_snapshot((torch.rand(300_000, 3), faces))})
    assert recorder.write().endswith("1 frame was larger than the limit and is left out")


def test_a_mesh_without_drawable_faces_is_an_empty_frame(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.html")
    mesh = nr.Mesh.icosphere(1)
    recorder.add(0, {"mesh": take_snapshot((torch.full_like(mesh.vertices, torch.nan), mesh.faces))})
    recorder.write()
    assert Record(tmp_path / "run.html").meshes(0) == {}


def test_the_file_needs_nothing_else(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.html")
    recorder.add(0, {"</script>": take_snapshot(nr.Mesh.icosphere(1))})
    recorder.write()
    text = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=|https?://|@import|url\(""", text)
    assert text.count("</script>") == 2  # a name cannot end the data
    assert list(Record(tmp_path / "run.html").meshes(0)) == ["</script>"]


def test_names_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"record: expected a name that ends in \.html, got 'run\.txt'"):
        Recorder(tmp_path / "run.txt")
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(ValueError, match="record: expected a file, got the folder"):
        Recorder(tmp_path / "folder.html")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        Recorder(tmp_path / "file" / "run.html")


def test_damaged_records_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.html"
    recorder = Recorder(path)
    with pytest.raises(ValueError, match="expected a record with frames"):
        Record(path)
    recorder.add(0, {"mesh": take_snapshot(nr.Mesh.icosphere(1))})
    recorder.write()
    text = path.read_text(encoding="utf-8")
    (tmp_path / "other.html").write_text("<html></html>")
    assert not is_record(tmp_path / "other.html")
    with pytest.raises(ValueError, match="expected a record, got another HTML file"):
        Record(tmp_path / "other.html")
    cut = text[: text.index(BEGIN) + len(BEGIN) + 200]
    for damaged in (cut, text.replace('"frames":[', '"frames":7,"x":['), text.replace(END, "")):
        path.write_text(damaged, encoding="utf-8")
        with pytest.raises(ValueError, match="expected a record, got a damaged one"):
            Record(path)
    path.write_text(text.replace('"format":1', '"format":99'), encoding="utf-8")
    with pytest.raises(ValueError, match="expected a record of format 1, got 99"):
        Record(path)
    begin = text.index('"blobs":{') + 9
    name = re.search(r'"(\w+)":"', text[begin:])
    assert name is not None and text[: text.index(BEGIN)]
    start = begin + name.end()
    for damage in ("!!!!", "AAAA", "x"):
        path.write_text(text[:start] + damage + text[start + 4 :], encoding="utf-8")
        with pytest.raises(ValueError, match="frame 0 is damaged"):
            Record(path).meshes(0)


def test_a_frame_has_a_limit_of_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte of a record of others could be a gigabyte of numbers, once for each part of a mesh."""
    recorder = Recorder(tmp_path / "run.html")
    recorder.add(0, {"ball": take_snapshot(nr.Mesh.icosphere(1))})
    recorder.write()
    assert Record(tmp_path / "run.html").meshes(0)
    monkeypatch.setattr("neural_renderer.apps.view.records.replay._LARGEST", 1000)
    with pytest.raises(ValueError, match=r"run.html: frame 0 is damaged \(its arrays and images have more than 0 MiB"):
        Record(tmp_path / "run.html").meshes(0)


def test_nested_records_are_refused(tmp_path: Path) -> None:
    (tmp_path / "run.html").write_text(f"{BEGIN}{'[' * 100_000}{END}")
    with pytest.raises(ValueError, match=r"run.html: expected a record, got a damaged one"):
        Record(tmp_path / "run.html")


def test_labels_and_steps_that_repeat_replace_each_other(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.html")
    mesh = take_snapshot(nr.Mesh.icosphere(1))
    recorder.add(4, {"a": mesh}, "shape")
    recorder.add(4, {"a": mesh, "b": replace(mesh)}, "shape")
    recorder.write()
    record = Record(tmp_path / "run.html")
    assert record.labels == ["shape step 4"] and sorted(record.meshes(0)) == ["a", "b"]


def test_nothing_of_viser_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with nr.view(browser=False, record=tmp_path / "run.html") as viewer:
        viewer.show(nr.Mesh.icosphere(1))
    assert len(Record(tmp_path / "run.html")) == 1


def test_curves_of_phases_follow_each_other(tmp_path: Path) -> None:
    """Phases count their steps from 1; a frame that is added late belongs to its own phase."""
    recorder = Recorder(tmp_path / "run.html")
    copy = {"mesh": take_snapshot(nr.Mesh.icosphere(0))}
    for step in range(1, 6):
        recorder.log(step, {"loss": 1.0})
    recorder.add(4, copy, "shape")
    recorder.log(1, {"loss": 2.0})
    recorder.add(5, copy, "shape")
    recorder.log(2, {"loss": 2.0})
    recorder.add(2, copy, "texture")
    recorder.write()
    assert [step for step, _ in Record(recorder.path).numbers["loss"]] == [1, 2, 3, 4, 5, 6, 7]
    assert [frame["place"] for frame in recorder._frames] == [4, 5, 7]


@pytest.mark.parametrize("numbers", [[1], {"a": "x"}, {"a": [[1]]}, {"a": [[1, "y"]]}, {"a": [[10**400, 1]]}])
def test_curves_of_any_kind(numbers: Any, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.html")
    recorder.write()
    text = (tmp_path / "a.html").read_text()
    begin = text.index(BEGIN) + len(BEGIN)
    end = text.index(END, begin)
    data = json.loads(text[begin:end]) | {"numbers": numbers}
    (tmp_path / "a.html").write_text(text[:begin] + json.dumps(data) + text[end:])
    with pytest.raises(ValueError, match=r"a.html: expected a record, got a damaged one"):
        Record(tmp_path / "a.html")
