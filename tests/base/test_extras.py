"""The extras of pyproject.toml: one for each application, old names, and the messages that name them."""

from __future__ import annotations

import re
import sys
from typing import Any

import pytest

from neural_renderer.apps import command_line as cli
from neural_renderer.base.extras import EXTRAS, advice
from neural_renderer.io.files import import_library
from tests.paths import ROOT

LIBRARIES = [library for libraries in EXTRAS.values() for library in libraries]
FIRST = [(next(name for name in EXTRAS if library in EXTRAS[name]), library) for library in dict.fromkeys(LIBRARIES)]
"""Each library with the first extra that has it, which messages name."""
OLD = {
    "reconstruction": {"lightning", "manifold3d", "tensorboard"},
    "editing": {"safetensors"},
    "photos": {"pycolmap"},
    "unwrap": {"xatlas"},
    "data": {"pyarrow"},
    "exr": {"OpenEXR"},
    "cluster": {"ray", "pyarrow"},
    "view": {"viser"},
}
"""Libraries of the extras of version 2.1."""


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    tomllib = pytest.importorskip("tomllib", reason="tomllib is new in Python 3.11")
    path = ROOT / "pyproject.toml"
    if not path.is_file():
        pytest.skip("the sources of the package are not here")
    return tomllib.loads(path.read_text(encoding="utf-8"))["project"]


def libraries(requirements: list[str], extras: dict[str, list[str]]) -> set[str]:
    """Names of required libraries; an extra of this package stands for its own requirements."""
    found: set[str] = set()
    for requirement in requirements:
        name, inner = re.match(r"([\w-]+)(?:\[([\w,]+)\])?", requirement).groups()
        if name == "neural-renderer":
            found |= {library for extra in inner.split(",") for library in libraries(extras[extra], extras)}
        else:
            found.add(name.replace("-", "_"))
    return found


def test_messages_know_the_extras(project: dict[str, Any]) -> None:
    extras = project["optional-dependencies"]
    assert {name: libraries(extras[name], extras) for name in EXTRAS} == {k: set(v) for k, v in EXTRAS.items()}


def test_a_plain_install_has_no_library_of_an_extra(project: dict[str, Any]) -> None:
    assert libraries(project["dependencies"], {}).isdisjoint(LIBRARIES)


@pytest.mark.parametrize("name", ["all", "dev"])
def test_all_extras_at_once(name: str, project: dict[str, Any]) -> None:
    extras = project["optional-dependencies"]
    assert libraries(extras[name], extras) >= set(LIBRARIES)


@pytest.mark.parametrize("name", OLD)
def test_old_names_install_what_they_did(name: str, project: dict[str, Any]) -> None:
    extras = project["optional-dependencies"]
    assert libraries(extras[name], extras) >= OLD[name]
    assert libraries(extras[name], extras) <= set(LIBRARIES)


@pytest.mark.parametrize(("extra", "library"), FIRST)
def test_a_missing_library_names_its_extra(extra: str, library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    sentence = f'^expected {library} to be installed for this \\(pip install "neural-renderer\\[{extra}\\]"\\)$'
    with pytest.raises(ModuleNotFoundError, match=sentence):
        import_library(library, "for this")


def test_optional_libraries_have_an_extra() -> None:
    """Whatever the source imports where it may be missing belongs to an extra, but for rawpy, which few need."""
    text = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py"))
    found = {name.partition(".")[0] for name in re.findall(r'import_library\("([\w.]+)"', text)}
    assert found and found <= {*LIBRARIES, "rawpy"}
    assert advice("numpy") == "pip install numpy"


def test_info_lists_the_extras(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert cli.main(["info"]) == 0
    rows = re.findall(r"^extra (\w+) +(.*?) *$", capsys.readouterr().out, re.MULTILINE)
    assert [name for name, _ in rows] == list(EXTRAS)
    assert dict(rows)["view"] == 'missing: viser (pip install "neural-renderer[view]")'
    for name, said in rows:
        assert all(library in said for library in EXTRAS[name]) or said.startswith("missing: ")
