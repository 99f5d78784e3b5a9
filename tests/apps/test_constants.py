"""Each number that a module of `fit` or `pose` chose stands on a page, with its value and what it was measured by."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_docs import ROOT

APPS, PAGE = ROOT / "src/neural_renderer/apps", ROOT / "docs/benchmarks/constants.md"
PLACES = (
    *("fit", "pose", "common/masks", "common/views", "common/options.py", "common/pictures/photograph.py"),
    *(f"reconstruct/evaluation/{name}.py" for name in ("cutout", "familiarity", "picture")),
)
UNITS = (45, 90, 180, 255, 360)
POWERS_OF_TEN = {float(f"1e{power}") for power in range(-30, 30)} - {0.1, 0.01}

pytestmark = pytest.mark.skipif(not PAGE.is_file(), reason="the documentation is not here")


def choices(node: ast.AST, compared: bool = False) -> Iterator[ast.Constant]:
    """Yield the numbers in a part of a program that its author chose, by the rule of the page."""
    match node:
        case ast.Constant(value=bool()):
            return
        case ast.Constant(value=int() | float() as number):
            is_small = isinstance(number, int) and number < (4 if compared else 10)
            if not (is_small or number in (0, 0.5, 1, *UNITS) or (number in POWERS_OF_TEN and not compared)):
                yield node
        case ast.Compare(ops=signs):
            compared = any(isinstance(sign, ast.Lt | ast.LtE | ast.Gt | ast.GtE) for sign in signs)
        case _:
            compared = compared and isinstance(node, ast.BinOp | ast.UnaryOp | ast.operator | ast.unaryop)
    for child in ast.iter_child_nodes(node):
        yield from choices(child, compared)


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
        case ast.Tuple(elts=parts) | ast.Dict(values=parts):
            return all(_is_number(part) for part in parts)
    return False


def named(node: ast.AST, owner: str = "") -> Iterator[tuple[str, ast.expr]]:
    """Yield name and value of a module's constants with numbers, and of fields and arguments with such defaults."""
    for part in ast.iter_child_nodes(node):
        match part:
            case ast.Assign(targets=[target], value=value) | ast.AnnAssign(target=target, value=ast.expr() as value):
                for name, one in _pairs(target, value):
                    is_constant = not owner and name.isupper() and _is_number(one)
                    if is_constant or any(choices(one)):
                        yield owner + name, one
            case ast.ClassDef():
                yield from named(part, f"{part.name}.")
            case ast.FunctionDef(args=args):
                of = owner if part.name == "__init__" else f"{owner}{part.name}."
                arguments = [*args.posonlyargs, *args.args]
                defaults = [*zip(arguments[len(arguments) - len(args.defaults) :], args.defaults, strict=True)]
                for argument, default in [*defaults, *zip(args.kwonlyargs, args.kw_defaults, strict=True)]:
                    if default is not None and any(choices(default)):
                        yield of + argument.arg, default


def _pairs(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    """Yield each name of an assignment with its value."""
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        yield from zip(map(ast.unparse, target.elts), value.elts, strict=True)
    else:
        yield ast.unparse(target), value


def modules() -> Iterator[tuple[Path, str, ast.Module]]:
    places = [APPS / place for place in PLACES]
    for file in sorted(file for place in places for file in (place.rglob("*.py") if place.is_dir() else [place])):
        source = file.read_text(encoding="utf-8")
        yield file.relative_to(APPS), source, ast.parse(source)


def constants() -> Iterator[tuple[str, str, str]]:
    """Yield folder, module and text, ``NAME = value``, of each number, or numbers, that has a name."""
    for file, source, tree in modules():
        for name, value in named(tree):
            yield file.parent.as_posix(), file.stem, f"{name} = {ast.get_source_segment(source, value)}"


def on_the_page() -> set[tuple[str, str, str]]:
    """Find constants of the page: ``## folder``, and in it ```module.NAME = value```."""
    found = set()
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        folder = section.partition("\n")[0].strip("` ")
        found |= {(folder, module, rest) for module, rest in re.findall(r"`(\w+)\.([\w.]+ = [^`\n]+)`", section)}
    return found


def test_every_constant_stands_on_the_page_with_its_value() -> None:
    in_code, described = set(constants()), on_the_page()
    assert not in_code - described, f"not on {PAGE.name}, or with another value"
    assert not described - in_code, "only on the page"


def test_functions_have_no_numbers_without_a_name() -> None:
    found = []
    for file, _, tree in modules():
        with_names = {id(part) for _, value in named(tree) for part in ast.walk(value)}
        found += [f"{file}:{part.lineno}: {part.value}" for part in choices(tree) if id(part) not in with_names]
    assert not found, "expected constants of the modules, which stand on the page"


@pytest.mark.parametrize(
    ("program", "found"),
    [
        ("x[3:6], 2**8, len(x) < 3, 1e-6, 0.5, angle < 90", []),
        ("x < 4, x > 1e-4, y + 2.5 <= x, f(0.1), f(12), -0.2", [4, 1e-4, 2.5, 0.1, 12, 0.2]),
        ("pool(x, 5)[0] > 0.99 and x == 8", [0.99]),
        ("def f(x=0.3, *, y={'a': 12}): return x < {7}", [12, 0.3]),
    ],
)
def test_which_numbers_are_choices(program: str, found: list[float]) -> None:
    assert [part.value for part in choices(ast.parse(program))] == found
