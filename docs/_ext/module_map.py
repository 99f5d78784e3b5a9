"""The directive ``module-map``: every file of the package with the first line of its docstring."""

import ast
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import neural_renderer

SOURCE = Path(neural_renderer.__file__).parent


def _lines(folder: Path, depth: int = 0) -> list[tuple[str, str]]:
    """(indented name, first line of its docstring) of all files below a folder; files before folders."""
    found = []
    for path in sorted(folder.iterdir(), key=lambda path: (path.is_dir(), path.name)):
        file = path / "__init__.py" if path.is_dir() else path
        if file.suffix != ".py" or not file.is_file() or path.name == "__init__.py":
            continue
        summary = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n")[0]
        found.append(("  " * depth + path.name + ("/" if path.is_dir() else ""), summary))
        if path.is_dir():
            found += _lines(path, depth + 1)
    return found


class ModuleMap(SphinxDirective):
    """Draws the map as a block of text."""

    def run(self) -> list[nodes.Node]:
        for path in SOURCE.rglob("*.py"):
            self.env.note_dependency(str(path))
        lines = _lines(SOURCE)
        width = max(len(name) for name, _ in lines) + 2
        text = "\n".join(f"{name:{width}}{summary}".rstrip() for name, summary in lines)
        return [nodes.literal_block(text, text, language="none")]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("module-map", ModuleMap)
    return {"parallel_read_safe": True}
