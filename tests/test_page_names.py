"""Names in the documentation's prose exist: `nr.render`, `neural_renderer.apps.fit`, options such as `--held-out`."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import io
import re
from functools import cache
from typing import Any

import pytest

from neural_renderer.apps import command_line as cli
from tests.test_docs import PAGES, ROOT

FENCED = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
NAME = re.compile(r"(?<![\w./-])(?:nr|neural_renderer)((?:\.[A-Za-z_]\w*)+)")
OPTION = re.compile(r"(?<![\w-])(--[a-z][\w.-]*\w)")
OF_A_COMMAND = re.compile(r"^(?:neural-renderer )?((?:reconstruct |batch )?[a-z]+)\b.*?(--[a-z][\w.-]*\w)")
OTHERS = {
    "--debug", "--help", "--version", "--iterations",  # of every command
    "--device", "--host", "--emulated-cuda", "--sanitizer",  # of our tests and benchmarks
    "--torch-backend", "--find-links", "--from",  # of uv
    "--logdir", "--head",  # of TensorBoard, of Ray
    "--mip", "--pbr", "--resolution", "--wogui", "--max-iter",  # of nvdiffrast's samples
}  # fmt: skip
FORMER = {"CHANGELOG.md"}  # names what there was

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the documentation is not here")


def prose(text: str) -> list[str]:
    """Pieces of code in the text, not those of blocks."""
    return CODE.findall(FENCED.sub("", text))


def _known(thing: Any, name: str) -> bool:
    """Whether instances of a class have an attribute, of which the class itself knows nothing."""
    if not inspect.isclass(thing):
        return False
    fields = {field.name for field in dataclasses.fields(thing)} if dataclasses.is_dataclass(thing) else set()
    sources = "".join(
        inspect.getsource(base) for base in thing.__mro__ if base.__module__.startswith("neural_renderer")
    )
    return name in fields or re.search(rf"\bself\.{name}\b", sources) is not None


def exists(dotted: str) -> bool:
    """Whether ``neural_renderer`` has a name: a module, a public name, or an attribute of a class."""
    thing: Any = importlib.import_module("neural_renderer")
    path = "neural_renderer"
    for name in dotted.strip(".").split("."):
        path = f"{path}.{name}"
        try:
            thing = getattr(thing, name)
        except ImportError:  # the message says what to use instead of this module of the first packages
            return True
        except AttributeError:
            if not inspect.ismodule(thing):
                return _known(thing, name)
            try:
                thing = importlib.import_module(path)
            except ModuleNotFoundError:
                return False
    return True


@cache
def options(command: str) -> frozenset[str]:
    """Options of a command, which its help names."""
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
        patch.setenv("COLUMNS", "200")
        patch.setenv("NO_COLOR", "1")
        cli.main([*command.split(), "--help"])
    return frozenset(OPTION.findall(out.getvalue()))


@cache
def commands() -> tuple[str, ...]:
    """All commands, and the kinds of `batch`."""
    return (*cli.command_names(), "batch fit", "batch style", "batch dream")


@cache
def programs() -> frozenset[str]:
    """Options of the programs in benchmarks and examples."""
    files = [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "examples").glob("*.py")]
    text = "".join(path.read_text(encoding="utf-8") for path in files)
    found = {name.replace("_", "-") for name in re.findall(r"^    (\w+): ", text, re.MULTILINE)}
    return frozenset(f"--{name}" for name in found) | frozenset(OPTION.findall(text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_names_exist(page: Any) -> None:
    if page.name in FORMER:
        pytest.skip("names of former versions")
    pieces = prose(page.read_text(encoding="utf-8"))
    missing = sorted({name for piece in pieces for name in NAME.findall(piece) if not exists(name)})
    assert not missing, f"{page.name}: expected names of the package, got {', '.join(missing)}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_options_exist(page: Any) -> None:
    if page.name in FORMER:
        pytest.skip("options of former versions")
    pieces = prose(page.read_text(encoding="utf-8"))
    known = OTHERS.union(programs(), *(options(command) for command in commands()))
    missing = {name for piece in pieces for name in OPTION.findall(piece) if name not in known}
    for piece in pieces:
        found = OF_A_COMMAND.match(piece)
        if found and found[1] in commands() and found[2] not in options(found[1]) | OTHERS:
            missing.add(f"{found[1]} {found[2]}")
    assert not missing, f"{page.name}: expected options of the commands, got {', '.join(sorted(missing))}"


def test_files_that_the_code_names_exist() -> None:
    """Paths in backticks, such as `raster/kernels/nmr.h`, may begin at any folder."""
    files = [
        path for folder in ("src", "tests", "docs", "benchmarks", "examples") for path in (ROOT / folder).rglob("*")
    ]
    known = {"/" + path.relative_to(ROOT).as_posix() for path in files}
    ends = {path[place.start() :] for path in known for place in re.finditer("/", path)} | {"/test_render_meshes.py"}
    for path in files:
        if path.suffix in (".py", ".h", ".cpp"):
            for name in re.findall(r"(?<!`)`([\w./-]+(?:\.py|\.h|/))`", path.read_text(encoding="utf-8")):
                assert f"/{name.strip('/')}" in ends, f"{path}: expected files and folders that exist, got {name}"


def test_names_of_code_on_pages_for_developers_exist() -> None:
    """Identifiers in backticks, such as `EdgeBackward`, occur in a program."""
    folders = ("src", "tests", "benchmarks", "docs", "examples")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*") if "develop" not in path.parts]
    code = [file for file in files if file.suffix in (".py", ".h", ".cpp")] + [ROOT / "Makefile"]
    known = set(re.findall(r"\w+", "\n".join(file.read_text(encoding="utf-8") for file in code)))
    known |= {word for file in files for word in re.findall(r"\w+", file.name)}
    for page in (ROOT / "docs/develop").rglob("*.md"):
        if page.name not in ("other_gpus.md", "releasing.md"):  # names of other programs; versions
            names = re.findall(r"^[A-Za-z_][\w.]*", "\n".join(prose(page.read_text(encoding="utf-8"))), re.MULTILINE)
            missing = {word for name in names for word in name.split(".") if word and word not in known}
            assert not missing, f"{page.name}: expected names in the code, got {', '.join(sorted(missing))}"


def test_wrong_names_are_found() -> None:
    assert exists(".render") and exists(".Mesh.vertices") and exists(".apps.fit.MeshFit") and exists(".losses")
    assert not exists(".rendr") and not exists(".Mesh.corners") and not exists(".apps.fitting")
    assert "--held-out" in options("fit") and "--holdout" not in options("fit") and len(commands()) >= 17
    assert prose("`nr.a`\n```\n`nr.b`\n```\n``nr.c``") == ["nr.a"]
