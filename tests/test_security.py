"""SECURITY.md names tests that exist."""

from __future__ import annotations

import re

from tests.paths import ROOT


def test_promises_name_their_tests() -> None:
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    head, _, *rows = text[text.index("| Promise | Tests |") :].partition("\n\n")[0].splitlines()
    assert len(rows) > 8, head
    for row in rows:
        named = re.findall(r"`(tests/[\w/]+\.py)`", row)
        assert named, row
        for name in named:
            assert (ROOT / name).is_file(), name
