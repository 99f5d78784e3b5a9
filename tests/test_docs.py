"""The documentation names files that exist and links to pages that exist."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from neural_renderer.apps import command_line as cli

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("benchmarks/*.md"), *ROOT.glob("docs/**/*.md")]
NAMED = re.compile(r"`((?:[\w-]+/)*[\w-]+\.py)`")
LINKED = re.compile(r"\]\((?!https?://|#|mailto:)([^)\s#]+)")

COMMANDS = re.compile(r"^ *neural-renderer ((?:.*\\\n)*.*)$", re.MULTILINE)

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the documentation is not here")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    files = [
        path.as_posix() for folder in ("src", "tests", "benchmarks", "docs") for path in (ROOT / folder).rglob("*.py")
    ]
    if page.name != "CHANGELOG.md":  # it names former files
        missing = [name for name in NAMED.findall(text) if not any(file.endswith("/" + name) for file in files)]
        assert not missing, f"{page.name}: expected names of files, got {', '.join(missing)}"
    broken = [link for link in LINKED.findall(text) if not (page.parent / link).exists()]
    assert not broken, f"{page.name}: expected links to files, got {', '.join(broken)}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_are_understood(page: Path) -> None:
    for command in COMMANDS.findall(page.read_text(encoding="utf-8")):
        alone = re.sub(r"\$\w+", "1", command.partition(";")[0].replace("\\\n", " "))  # variables of the shell
        arguments = shlex.split(alone, comments=True)
        if "--help" not in arguments:
            cli._parse(arguments)


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "tools").glob("*.md")), ids=lambda page: page.name)
def test_pages_of_tools_are_short(page: Path) -> None:
    """Two screens: measurements belong to docs/benchmarks, methods to docs/concepts, each option to its help."""
    shown = re.sub(r"<!--.*?-->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    words = [word for word in shown.split() if re.search(r"\w", word)]
    assert len(words) <= 750, f"{page.name}: expected at most 750 words, got {len(words)}"


def test_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its programs, one after the other, in a clone."""
    blocks = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    shutil.copytree(ROOT / "examples" / "data", tmp_path / "examples" / "data")
    monkeypatch.chdir(tmp_path)
    exec("\n".join(blocks), {})
