"""The pages for users of other renderers: their tables, and the checks of their rows."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.paths import ROOT

GUIDES = ROOT / "docs" / "guides"
_CODE = re.compile(r"`([^`]+)`")
_PROGRAM = re.compile(r"```python\n(.*?)```", re.DOTALL)
_HEADS = ("here", "modern")

Check = Callable[[dict[str, Any], list[Any]], None]

needs_pages = pytest.mark.skipif(not GUIDES.is_dir(), reason="the documentation is not here")


class Page:
    """A page with tables of two columns, a program that names what their right columns use, and checks of the rows.

    A check takes those names and the values of the pieces of code in a row's right cell, in order. It compares them
    with numbers of the other renderer: formulas of its documentation, or pictures of its tests.
    """

    def __init__(self, name: str) -> None:
        self.text = (GUIDES / name).read_text(encoding="utf-8") if GUIDES.is_dir() else ""
        self.programs = _PROGRAM.findall(self.text)
        tables = re.sub(r"^\| program \|.*?^$", "", self.text, flags=re.MULTILINE | re.DOTALL)  # which were run
        lines = [line for line in tables.splitlines() if line.startswith("|")]
        cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
        cells = [row for row in cells if not set(row[0]) <= set("-|") and row[1].split()[0] not in _HEADS]
        self.rows, self.count = {row[0]: row[1] for row in cells}, len(cells)
        self.checks: dict[str, Check] = {}

    def row(self, *starts: str) -> Callable[[Check], Check]:
        """Register a check of the rows whose left cells start like this."""

        def register(check: Check) -> Check:
            self.checks.update(dict.fromkeys(starts, check))
            return check

        return register

    def start_of(self, left: str) -> str | None:
        """Return the longest registered start of a left cell."""
        return max((start for start in self.checks if left.startswith(start)), key=len, default=None)

    def missing(self) -> list[str]:
        """List rows without a check, checks without a row, and rows that are twice on the page."""
        starts = {left: self.start_of(left) for left in self.rows}
        rows = [left for left, start in starts.items() if start is None]
        checks = [start for start in self.checks if start not in starts.values()]
        return rows + checks + ["a row that is twice on the page"] * (self.count != len(self.rows))

    def names(self) -> dict[str, Any]:
        """Run the page's first program; return its names."""
        torch.manual_seed(0)
        given: dict[str, Any] = {}
        exec(self.programs[0], given)
        return given

    def check(self, left: str, given: dict[str, Any]) -> None:
        """Run the code of a row, and its check."""
        values = run(self.rows[left], given)
        start = self.start_of(left)
        assert start is not None, f"expected a check of the row {left}"
        self.checks[start](given, values)


def run(cell: str, given: dict[str, Any]) -> list[Any]:
    """Run the pieces of code of a cell that are more than a name or a shape; return values, None for assignments."""
    values = []
    for code in _CODE.findall(cell):
        if re.fullmatch(r"\w+|\[[A-Z, 0-9]+\]|\w+=\w+", code) and code not in given:
            continue
        assert "…" not in code, f"expected code that runs, got {code}"
        try:
            values.append(eval(code, given))
        except SyntaxError:
            exec(code, given)
            values.append(None)
    return values


def same_but_at_edges(found: Tensor, expected: Tensor, tolerance: float, at_edges: float) -> None:
    """Assert that images [..., H, W] or [..., H, W, C] differ by no more than a tolerance but in a share of numbers.

    Where the centre of a pixel lies within rounding of an edge, either of two faces may be drawn.
    """
    assert found.shape == expected.shape, f"expected {list(expected.shape)}, got {list(found.shape)}"
    differs = (found.double() - expected.double()).abs() > tolerance
    assert differs.double().mean() <= at_edges, (
        f"expected {at_edges} of numbers to differ, got {differs.double().mean()}"
    )
