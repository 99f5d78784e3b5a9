"""Docstrings of public names are complete, and their examples run and print the stated results."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import io
import re
import tokenize
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest
import torch

import neural_renderer as nr

SOURCE = Path(nr.__file__).parent
REFERENCE = Path(__file__).parents[1] / "docs" / "reference"
FILES = [path for path in sorted(SOURCE.rglob("*.py")) if ">>>" in path.read_text(encoding="utf-8")]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

# These take any arguments of the annotated types.
NEVER_RAISES = {
    "Comparison",
    "Comparison.failures",
    "ViewErrors",
    "Mesh.set_lr",
    "ObjectPose",
    "Texture.transformed",
    "Finished",
    "FitResult",
    "Views.to",
    "Views.normalized",
    "MeshFit.normalize",
    "Style.background",
    "Dream.background",
    "RandomViews.sample",
    "RandomViews.fixed",
    "FeatureNetwork",
    "Config",
    "Viewer.offer",
    "Viewer.finish",
    "Remeshed",
    "Reconstruction",
    "Shapes",
    "cuda_on_cpu",
    "stand_in",
}
WITHOUT_EXAMPLE = {
    "Style.losses",  # an edit calls them, as in the example of `MeshEdit`
    "Dream.losses",
    "googlenet",  # needs a file of 50 MB
    "DetailFit.turn",  # the old name of `adjust`
    "ShapeFit.turn",
}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_examples_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    module = importlib.import_module(".".join(("neural_renderer", *parts)))
    monkeypatch.chdir(tmp_path)  # an example may write files
    names = vars(module) | {name: getattr(nr, name) for name in nr.__all__}
    # Examples may take a mesh and a camera as given.
    mesh, camera = nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)
    given = names | {"nr": nr, "torch": torch, "mesh": mesh, "camera": camera}
    finder, runner = doctest.DocTestFinder(exclude_empty=True), doctest.DocTestRunner(optionflags=FLAGS)
    report: list[str] = []
    for example in finder.find(module, module.__name__, globs=given):
        torch.manual_seed(0)
        runner.run(example, out=report.append)
    assert not runner.summarize(verbose=False).failed, "".join(report)


def test_bars_are_no_substitutions() -> None:
    """Sphinx takes |x| in a docstring for the name of a text to insert, and fails."""
    for name, (thing, _) in PUBLIC.items():
        function = thing.fget if isinstance(thing, property) else getattr(thing, "__func__", thing)
        text = re.sub(r"``.*?``|^ *>>> .*$", "", inspect.getdoc(function) or "", flags=re.MULTILINE)
        found = re.search(r"(?<![\w`])\|[^\s|](?:[^|\n]*[^\s|])?\|", text)
        assert not found, f"{name}: expected words or ``…`` in place of {found[0] if found else ''}"


def directives() -> Iterator[tuple[str, str, dict[str, str]]]:
    """(module, name, options) of each function and class on the pages of the reference."""
    for page in sorted(REFERENCE.glob("*.md")):
        module = ""
        for block in re.findall(r"\.\. ((?:currentmodule|auto(?:function|class)):: .*(?:\n   :.*)*)", page.read_text()):
            kind, name = re.match(r"(\w+):: (\S+)", block).groups()
            if kind == "currentmodule":
                module = name
            else:
                yield module, name, dict(re.findall(r"^   :([\w-]+): *(.*)", block, re.MULTILINE))


def public() -> dict[str, tuple[Any, Any]]:
    """Functions, classes and methods on the pages of the reference by name, each with its class or None."""
    found: dict[str, tuple[Any, Any]] = {}
    for module, name, options in directives():
        thing = getattr(importlib.import_module(module), name)
        prefix = f"{module.rpartition('.')[2]}." if module.endswith(("losses", "metrics", "rotations")) else ""
        found[prefix + name] = thing, None
        if "members" in options:
            members = [part for part in options["members"].split(", ") if part]
            every = [thing]
            if "inherited-members" in options:  # up to the named class
                last = options["inherited-members"] or "object"
                every = list(takewhile(lambda base, last=last: base.__name__ != last, thing.__mro__))
            members = members or [part for owner in every for part in vars(owner) if not part.startswith("_")]
            members += [part for part in options.get("special-members", "").split(", ") if part]
            left_out = options.get("exclude-members", "").split(", ")
            for member in members:
                method = inspect.getattr_static(thing, member)
                if member not in left_out and (
                    isinstance(method, (classmethod, property)) or inspect.isroutine(method)
                ):
                    found[f"{name}.{member}"] = method, thing
    return found


PUBLIC = public()


def sections(docstring: str) -> dict[str, str]:
    """Split a docstring into sections by heading; the part before them is "Summary"."""
    heading = r"^(Args|Attributes|Returns|Raises|Warns|Example):\n"
    parts = ["Summary", *re.split(heading, docstring, flags=re.MULTILINE)]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def entries(section: str) -> set[str]:
    """Names that a section of arguments or attributes explains."""
    return {
        name for line in re.findall(r"^    ([\w*]+(?:, \w+)*):", section, re.MULTILINE) for name in line.split(", ")
    }


def test_the_reference_lists_every_public_name() -> None:
    modules = {"data", "losses", "metrics", "optim", "rotations"}  # their functions have pages
    assert set(nr.__all__) - modules - {"__version__"} <= set(PUBLIC)


@pytest.mark.parametrize("name", PUBLIC)
def test_docstrings_are_complete(name: str) -> None:
    thing, owner = PUBLIC[name]
    function = thing.fget if isinstance(thing, property) else getattr(thing, "__func__", thing)
    found = sections(inspect.getdoc(function) or "")
    first = found["Summary"].partition("\n")[0]
    assert re.match(r"[A-Z(].*\.$", first), f"expected a sentence in the first line, got {first!r}"
    if isinstance(thing, property):
        return
    signature = inspect.signature(function)
    arguments = [part for part in signature.parameters.values() if part.name not in ("self", "cls", "_")]
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    explained = entries(found.get("Args", "")) | (entries(found.get("Attributes", "")) if owner is None else set())
    assert {stars.get(part.kind, "") + part.name for part in arguments} <= explained
    if not inspect.isclass(function) and signature.return_annotation not in (None, "None"):
        assert "Returns" in found
    assert not arguments or ("Raises" in found) != (name in NEVER_RAISES)
    # A method has an example of its own, or its class's example calls it.
    own = found.get("Example", "")
    of_class = sections(inspect.getdoc(owner) or "").get("Example", "") if owner else ""
    call = f".{name.rpartition('.')[2]}("
    shown = (">>>" in own and "+SKIP" not in own) or call in of_class or name.endswith(".forward")
    assert shown == (name not in WITHOUT_EXAMPLE)


AMERICAN = re.compile(
    r"\b(?:colors?|colored|gray|centers?|centered|neighbors?|behaviors?|[^\W_]+[^\W_s]iz(?:e[ds]?|ing|ations?))\b",
    re.IGNORECASE,
)


def prose(source: str) -> Iterator[str]:
    """Comments and docstrings of a file, without names in backquotes, quotations and examples.

    Files without American words after a # are not split into tokens, which takes as long as all the rest.
    """
    quoted = '`+[^`]*`+|"[^"]*"'
    if any(AMERICAN.search(comment) for comment in re.findall("#.*", source)):
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.COMMENT and not re.search("noqa|type:", token.string):
                yield re.sub(quoted, "", token.string)
    if not any(AMERICAN.search(text) for text in re.findall('""".*?"""', source, re.DOTALL)):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module)):
            text = re.sub(quoted, "", ast.get_docstring(node) or "")
            yield from re.sub(r"(?m)^ *(>>>|\.\.\.|[\w*, ]+: ).*$", "", text).splitlines()


def test_prose_is_british() -> None:
    found = [
        f"{path.relative_to(SOURCE)}: {line.strip()}"
        for path in sorted(SOURCE.rglob("*.py"))
        for line in prose(path.read_text(encoding="utf-8"))
        if AMERICAN.search(line)
    ]
    assert not found, f"expected British spelling in prose, and backquotes around names, got {found}"
