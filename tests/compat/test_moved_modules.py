"""Modules under the names that they had before version 2.2."""

from __future__ import annotations

import importlib
import sys
import warnings

import pytest

from neural_renderer.compat.moved_modules import KEPT, MOVED, new_name
from tests.programs import run_python


@pytest.mark.parametrize("old", [*KEPT, *MOVED])
def test_the_old_name_is_the_new_module(old: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that stay for good say nothing; the others say once where the module is now."""
    name, new = f"neural_renderer.{old}", f"neural_renderer.{(KEPT | MOVED)[old]}"
    known = {key for key in sys.modules if new_name(key)}
    for key in known:
        monkeypatch.delitem(sys.modules, key)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        module = importlib.import_module(name)
    assert module is importlib.import_module(new) and module.__name__ == new
    told = [str(warning.message) for warning in caught if warning.category is DeprecationWarning]
    assert any(text == f"{name} is {new} since version 2.2" for text in told) == (old in MOVED)


def test_members_of_old_modules() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        old = importlib.import_module("neural_renderer.tasks.fit")
        inner = importlib.import_module("neural_renderer.tasks.editing.style")
    new = importlib.import_module("neural_renderer.apps.fit")
    assert old.ShapeFit is new.ShapeFit and inner.Style is importlib.import_module("neural_renderer.apps.edit").Style
    assert new_name("neural_renderer.raster") is None and new_name("other.tasks") is None


def test_the_old_command_line_still_runs_as_a_program() -> None:
    done = run_python("-m", "neural_renderer.cli", "--version")
    assert done.returncode == 0 and done.stdout.startswith("neural-renderer ")
