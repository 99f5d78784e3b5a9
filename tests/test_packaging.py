"""What a release consists of: one public address, one version and date, a changelog, workflows and their targets."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from typing import Any

import pytest

import neural_renderer as nr
from tests.paths import ROOT

# Files of other programs, and outputs, are not ours.
OURS = ("*.*", ".github/**/*.*", "src/**/*.py", "tests/*.py", "docs/**/*.md", "docs/*.py", "examples/**/*.md")
OURS = (*OURS, "benchmarks/*.py", "benchmarks/*.md")
OF_THE_PROJECT = re.compile(r"https?://(?!github\.com/hiroharu-kato/)[^\s)>\"']*neural[-_]renderer", re.IGNORECASE)

needs_workflows = pytest.mark.skipif(not (ROOT / ".github").is_dir(), reason="the workflows are not here")
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


def test_the_version_and_its_date_are_the_same_everywhere() -> None:
    """In the package, the citation and the changelog, whose first heading is the release, or what comes after it."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    version, date = re.findall(r"^## (\d+\.\d+\.\d+) - (\d{4}-\d\d-\d\d)$", changes, re.MULTILINE)[0]
    assert version == nr.__version__
    assert f"\nversion: {version}\ndate-released: {date}\n" in citation


def test_the_changelog_says_what_is_new_in_short_lines() -> None:
    """Added, Changed and Fixed, one line each, without measurements."""
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = changes.partition("\n## ")[2].partition("\n## ")[0]
    assert set(re.findall(r"^### (.*)$", newest, re.MULTILINE)) <= {"Added", "Changed", "Fixed"}
    lines = [line for line in newest.splitlines()[1:] if line and not line.startswith("#") and not line.endswith(":")]
    assert lines and all(line.startswith("- ") and len(line) <= 150 for line in lines)


@needs_workflows
def test_actions_of_the_workflows_are_pinned() -> None:
    """By a commit, with the release beside it; no job takes torch's build for CUDA."""
    for path in sorted((ROOT / ".github" / "workflows").glob("*.yml")):
        text = path.read_text(encoding="utf-8")
        used = re.findall(r"uses: (.*)$", text, re.MULTILINE)
        assert used and all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", action) for action in used)
        assert "PIP_EXTRA_INDEX_URL: https://download.pytorch.org/whl/cpu" in text


@needs_workflows
def test_make_and_the_workflows_have_the_same_targets() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    called = set(re.findall(r"run: make ([a-z-]+)$|target: ([a-z-]+)", workflow, re.MULTILINE))
    lines = re.findall(r"^ *make (.+)$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)
    ours = {word for line in lines for word in line.split() if re.fullmatch(r"[a-z][a-z-]*", word)}
    assert {name for pair in called for name in pair if name} | ours <= targets
    assert {"lint", "test", "test-native", "test-cuda-emulated"} <= ours


def test_links_of_the_page_on_pypi(functions: dict[str, Any]) -> None:
    page: Callable[[str, str], str] = functions["readme_for_pypi"]
    text = "![A bunny](bunny.png)\n\nSee [this](docs/start.md), [the paper](https://arxiv.org/) and [below](#below).\n"
    rest = "[the paper](https://arxiv.org/) and [below](#below).\n"
    assert page(text, "") == f"See this, {rest}"
    at = "https://example.org/us"
    assert page(text, at) == f"![A bunny]({at}/raw/main/bunny.png)\n\nSee [this]({at}/blob/main/docs/start.md), {rest}"
