"""Each number that a module of `fit` or `pose` chose stands on a page, with its value and what it was measured by."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.test_docs import ROOT

APPS, PAGE = ROOT / "src/neural_renderer/apps", ROOT / "docs/benchmarks/constants.md"
PLACES = (
    *("fit", "pose", "common/masks", "common/views", "common/pictures/photograph.py"),
    "reconstruct/evaluation/cutout.py",
)

pytestmark = pytest.mark.skipif(not PAGE.is_file(), reason="the documentation is not here")


def _is_number(node: ast.expr | None) -> bool:
    match node:
        case ast.Constant(value=bool()):
            return False
        case ast.Constant(value=int() | float()):
            return True
        case ast.UnaryOp(operand=operand):
            return _is_number(operand)
        case ast.BinOp(left=left, right=right):
            return _is_number(left) and _is_number(right)
        case ast.Tuple(elts=parts):
            return all(_is_number(part) for part in parts)
    return False


def constants() -> Iterator[tuple[str, str, str]]:
    """Yield folder, module and text, ``_NAME = value``, of each number, or numbers, with an upper-case name."""
    places = [APPS / place for place in PLACES]
    for file in sorted(file for place in places for file in (place.rglob("*.py") if place.is_dir() else [place])):
        source = file.read_text(encoding="utf-8")
        for statement in ast.parse(source).body:
            if isinstance(statement, ast.Assign | ast.AnnAssign) and _is_number(statement.value):
                target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
                for name, value in _pairs(target, statement.value):
                    if ast.unparse(name).isupper():
                        text = f"{ast.unparse(name)} = {ast.get_source_segment(source, value)}"
                        yield file.parent.relative_to(APPS).as_posix(), file.stem, text


def _pairs(target: ast.expr, value: ast.expr | None) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Yield each name of an assignment with its value."""
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        yield from zip(target.elts, value.elts, strict=True)
    elif value is not None:
        yield target, value


def on_the_page() -> set[tuple[str, str, str]]:
    """Find constants of the page: ``## folder``, and in it ```module._NAME = value```."""
    found = set()
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        folder = section.partition("\n")[0].strip("` ")
        found |= {(folder, module, rest) for module, rest in re.findall(r"`(\w+)\.([A-Z_][^`\n]* = [^`\n]+)`", section)}
    return found


def test_every_constant_stands_on_the_page_with_its_value() -> None:
    in_code, described = set(constants()), on_the_page()
    assert not in_code - described, f"not on {PAGE.name}, or with another value"
    assert not described - in_code, "only on the page"
