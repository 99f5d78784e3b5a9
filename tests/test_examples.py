"""The four examples of the first packages, run as programs on the published files."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import neural_renderer as nr
from neural_renderer.apps.fit import load_views
from tests.paths import EXAMPLES

Run = Callable[..., str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run an example on the CPU; return its output."""

    def run(number: int, iterations: int | None = None) -> str:
        output = tmp_path / "out.gif"
        arguments = ["-o", str(output), "-d", "cpu"]
        if iterations is not None:
            arguments += ["-n", str(iterations)]
        script = EXAMPLES / f"example{number}.py"
        monkeypatch.setattr(sys, "argv", [str(script), *arguments])
        monkeypatch.syspath_prepend(str(EXAMPLES))
        runpy.run_path(str(script), run_name="__main__")
        assert output.stat().st_size > 1000
        return capsys.readouterr().out

    return run


def losses(printed: str) -> list[float]:
    return [float(number) for number in re.findall(r"loss (\d+\.\d+)", printed)]


def test_example1_draws_90_pictures(run: Run) -> None:
    assert "90 pictures" in run(1)


def test_example2_approaches_a_square(run: Run) -> None:
    first, *_, last = losses(run(2, 41))
    assert first == pytest.approx(10103, rel=1e-3)
    assert last < 0.9 * first


@pytest.mark.slow
def test_example2_fits_a_square(run: Run) -> None:
    printed = run(2)
    first, *_, last = losses(printed)
    assert first == pytest.approx(10103, rel=1e-3)
    assert last < 12
    assert float(re.findall(r"IoU (\d\.\d+)", printed)[0]) > 0.999


def test_example3_paints(run: Run) -> None:
    first, *_, last = losses(run(3, 41))
    assert first == pytest.approx(101050, rel=0.03)  # the first side is drawn by chance
    assert last < 0.8 * first


def test_example4_approaches_the_camera(run: Run) -> None:
    first, *_, last = losses(run(4, 21))
    assert first == pytest.approx(8445, rel=1e-3)
    assert last < first - 50  # Adam moves it by 0.1 a step, of 14 to go


@pytest.mark.slow
def test_example4_finds_the_camera(run: Run) -> None:
    printed = run(4)
    first, *_, last = losses(printed)
    assert first == pytest.approx(8445, rel=1e-3)
    assert last < 70
    # The way is chaotic: moving the start by 1e-5 makes it 148 steps or 206.
    assert int(re.findall(r"after (\d+) steps", printed)[0]) < 400
    eye = [float(x) for x in re.findall(r"camera at \((.*), (.*), (.*)\)", printed)[0]]
    assert eye == pytest.approx([-0.612, 1.366, -2.285], abs=0.05)


def test_photographs_are_what_fit_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["photos.py", "-o", str(tmp_path / "photos"), "-n", "3", "-s", "64"]
    monkeypatch.setattr(sys, "argv", arguments)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    runpy.run_path(str(EXAMPLES / "photos.py"), run_name="__main__")
    views, spot = load_views(tmp_path / "photos"), nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    # Cameras come back from decimal numbers: a pixel whose samples are within a rounding of an edge may differ.
    assert len(views) == 3 and views.quality((spot.vertices, spot.faces))["iou"].min() > 0.99


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_missing_file_is_one_sentence(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    script = EXAMPLES / f"example{number}.py"
    monkeypatch.setattr(sys, "argv", [str(script), "-i", "nowhere.obj"])
    monkeypatch.syspath_prepend(str(EXAMPLES))
    with pytest.raises(SystemExit, match=r"--input: expected a file, got nowhere\.obj, which does not exist"):
        runpy.run_path(str(script), run_name="__main__")
