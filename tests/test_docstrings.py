"""Examples in docstrings run and give what they say."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest
import torch

import neural_renderer as nr

SOURCE = Path(nr.__file__).parent
FILES = [path for path in sorted(SOURCE.rglob("*.py")) if ">>>" in path.read_text(encoding="utf-8")]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_examples_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    module = importlib.import_module(".".join(("neural_renderer", *parts)))
    monkeypatch.chdir(tmp_path)  # an example may write files
    names = vars(module) | {name: getattr(nr, name) for name in nr.__all__}
    # Examples may take a mesh and a camera as given.
    mesh, camera = nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)
    given = names | {"nr": nr, "torch": torch, "mesh": mesh, "camera": camera}
    finder, runner = doctest.DocTestFinder(exclude_empty=True), doctest.DocTestRunner(optionflags=FLAGS)
    report: list[str] = []
    for example in finder.find(module, module.__name__, globs=given):
        torch.manual_seed(0)
        runner.run(example, out=report.append)
    assert not runner.summarize(verbose=False).failed, "".join(report)
