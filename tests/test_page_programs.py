"""Programs on the pages of the documentation run: code cells and blocks of Python, of each page in order.

They run as they stand. Slow pages are marked as slow; of some of them, two steps of each loop run in `make test`.
`make docs` runs all cells, too. Two comments, which the pages do not show, change what runs: "given" has lines that
run before a block, such as imports and files that the text assumes; "not run" has the reason why the next block does
not run.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from tests.paths import EXAMPLES, ROOT

DOCS = ROOT / "docs"
# More than four seconds of a processor; two steps of each loop of the first ones take less.
BEGUN = {"guides/shape.md", "notebooks/reconstruction.md", "notebooks/sphere_to_duck.md", "notebooks/style.md"}
SLOW = BEGUN | {"notebooks/body.md", "notebooks/finish.md", "notebooks/pose.md", "tools/fit.md"}
PIECE = re.compile(
    r"^<!-- (?P<comment>given|not run)\b:?(?P<text>.*?)-->$|^```(?P<kind>[^\n]*)\n(?P<body>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
OPTIONS = re.compile(r"\A(?::[\w-]+:.*\n)+")  # of a cell

pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="the documentation is not here")


def program(text: str) -> str:
    """The Python of a page on the lines where the page has it."""
    lines = [""] * (text.count("\n") + 1)
    skip = False
    for piece in PIECE.finditer(text):
        runs = piece["comment"] == "given"
        if piece["comment"] == "not run":
            skip = True
        elif piece["kind"] in ("python", "{code-cell} python3"):
            runs, skip = not skip, False
        if runs:
            group = "text" if piece["comment"] else "body"
            code = OPTIONS.sub(lambda options: "\n" * options[0].count("\n"), piece[group])
            first = text.count("\n", 0, piece.start(group))
            lines[first : first + code.count("\n") + 1] = code.split("\n")
    return "\n".join(lines)


def shortened(code: str) -> str:
    """Loops of many steps take two, so that a page takes seconds."""
    code = re.sub(r"\b(for \w+ in range)\(\d{2,}\):", r"\1(2):", code)
    return re.sub(r"\b(steps ?= ?)\d{3,}\b", r"\g<1>2", code)


PROGRAMS = {path: code for path in DOCS.rglob("*.md") if (code := program(path.read_text(encoding="utf-8"))).strip()}


def pages() -> list[Any]:
    """All pages with programs."""
    names = {path: path.relative_to(DOCS).as_posix() for path in sorted(PROGRAMS)}
    return [pytest.param(path, id=id, marks=[pytest.mark.slow] * (id in SLOW)) for path, id in names.items()]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A folder with the examples' data, and torch and Pillow as a program finds them."""
    shutil.copytree(EXAMPLES / "data", tmp_path / "examples" / "data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", Image.MAX_IMAGE_PIXELS)  # a page sets it
    deterministic = torch.are_deterministic_algorithms_enabled()
    yield
    torch.use_deterministic_algorithms(deterministic)


def run(code: str, page: Path) -> None:
    """Run the program of a page."""
    if "matplotlib" in code:
        pytest.importorskip("matplotlib").use("agg")
    exec(compile(code, str(page), "exec"), {"__name__": "page"})


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("page", pages())
def test_programs_run(page: Path) -> None:
    run(PROGRAMS[page], page)


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", sorted(BEGUN))
def test_slow_programs_begin(name: str) -> None:
    run(shortened(PROGRAMS[DOCS / name]), DOCS / name)


def test_few_programs_do_not_run() -> None:
    """Those of other renderers, of a GPU, of networks to download, and patterns with names of the reader's."""
    pages = {path.stem: path.read_text(encoding="utf-8") for path in DOCS.rglob("*.md")}
    reasons = {name: re.findall(r"^<!-- not run: (.+) -->$", text, re.MULTILINE) for name, text in pages.items()}
    assert sum(map(len, reasons.values())) <= 16
    assert all(len(reason.split()) > 1 for found in reasons.values() for reason in found)


def test_lines_of_a_program_are_those_of_its_page() -> None:
    text = "A\n\n<!-- given\nx = 1\n-->\n```python\ny = x\n```\n<!-- not run: a reason -->\n```python\n1 / 0\n```\n"
    text += "```{code-cell} python3\n:tags: [remove-input]\n\nz = y\n```\n```\nneither\n```\n"
    lines = program(text).split("\n")
    assert {number: line for number, line in enumerate(lines) if line} == {3: "x = 1", 6: "y = x", 15: "z = y"}
    assert [text.split("\n")[number] for number in (3, 6, 15)] == ["x = 1", "y = x", "z = y"]
    assert shortened("for step in range(200):\nfor part in range(8):\nsteps = 300") == (
        "for step in range(2):\nfor part in range(8):\nsteps = 2"
    )
