"""Progress of work in phases."""

from __future__ import annotations

import re

import pytest

from neural_renderer.apps.common.command import progress_bars


def test_a_file_gets_lines_as_the_work_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars() as report:
        report("features", 0, 8)
        report("features", 1, 8)
        assert re.fullmatch(r"features    0/8  \d+ s\n", capsys.readouterr().out), "at once, and no line a step"
        for done in range(2, 9):
            report("features", done, 8, f"loss {done}")
    assert re.findall(r"(\d)/8.*(loss \d)", capsys.readouterr().out) == [
        ("2", "loss 2"),
        ("4", "loss 4"),
        ("6", "loss 6"),
        ("8", "loss 8"),
    ]
