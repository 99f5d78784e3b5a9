"""The documentation names files that exist and links to pages that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("benchmarks/*.md"), *ROOT.glob("docs/**/*.md")]
NAMED = re.compile(r"`((?:[\w-]+/)*[\w-]+\.py)`")
LINKED = re.compile(r"\]\((?!https?://|#|mailto:)([^)\s#]+)")

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the documentation is not here")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    files = [
        path.as_posix() for folder in ("src", "tests", "benchmarks", "docs") for path in (ROOT / folder).rglob("*.py")
    ]
    if page.name != "CHANGELOG.md":  # it tells of files that were
        missing = [name for name in NAMED.findall(text) if not any(file.endswith("/" + name) for file in files)]
        assert not missing, f"{page.name}: expected names of files, got {', '.join(missing)}"
    broken = [link for link in LINKED.findall(text) if not (page.parent / link).exists()]
    assert not broken, f"{page.name}: expected links to files, got {', '.join(broken)}"
