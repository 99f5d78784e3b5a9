"""The repository's public address stands in pyproject.toml alone, and the page on PyPI follows from it."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from typing import Any

import pytest

from tests.paths import ROOT

# Files of other programs, and outputs, are not ours.
OURS = ("*.*", ".github/**/*.*", "src/**/*.py", "tests/*.py", "docs/**/*.md", "docs/*.py", "examples/**/*.md")
OURS = (*OURS, "benchmarks/*.py", "benchmarks/*.md")
OF_THE_PROJECT = re.compile(r"https?://(?!github\.com/hiroharu-kato/)[^\s)>\"']*neural[-_]renderer", re.IGNORECASE)

pytestmark = pytest.mark.skipif(not (ROOT / "setup.py").is_file(), reason="the sources of the package are not here")


@pytest.fixture
def functions(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Run setup.py and return what it defines."""
    setuptools = pytest.importorskip("setuptools")
    monkeypatch.setattr(setuptools, "setup", lambda **_: None)
    return runpy.run_path(str(ROOT / "setup.py"))


def test_the_address_stands_in_one_place(functions: dict[str, Any]) -> None:
    address = functions["public_address"]()
    for path in (path for pattern in OURS for path in ROOT.glob(pattern) if path.is_file()):
        if path.name == "pyproject.toml":
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        found = OF_THE_PROJECT.search(text)
        assert not found, f"{path}: expected the project's address in pyproject.toml alone, got {found}"
        assert not address or address not in text, f"{path}: expected {address} in pyproject.toml alone"


def test_links_of_the_page_on_pypi(functions: dict[str, Any]) -> None:
    page: Callable[[str, str], str] = functions["readme_for_pypi"]
    text = "![A bunny](bunny.png)\n\nSee [this](docs/start.md), [the paper](https://arxiv.org/) and [below](#below).\n"
    rest = "[the paper](https://arxiv.org/) and [below](#below).\n"
    assert page(text, "") == f"See this, {rest}"
    at = "https://example.org/us"
    assert page(text, at) == f"![A bunny]({at}/raw/main/bunny.png)\n\nSee [this]({at}/blob/main/docs/start.md), {rest}"
