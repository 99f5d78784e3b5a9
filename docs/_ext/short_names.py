"""Links from short names in docstrings, such as `render` or `Light.direction`, to the reference.

Sphinx looks for a name in the module of the docstring only. Names that the package has but the reference leaves out
stay plain code; a name that nothing has is a warning.
"""

import ast
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

import neural_renderer

SOURCE = Path(neural_renderer.__file__).parent
INHERITED = {"forward", "load_state_dict", "parameters", "state_dict", "to"}  # from torch


def _names() -> set[str]:
    """Names that the source defines: modules, and functions, classes and their members with and without the class."""
    found = {"neural_renderer"}
    for path in SOURCE.rglob("*.py"):
        found.add(path.stem)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            inner = node.body if isinstance(node, (ast.Module, ast.ClassDef)) else []
            names = {part.name for part in inner if isinstance(part, (ast.FunctionDef, ast.ClassDef))}
            for part in inner:
                targets = part.targets if isinstance(part, ast.Assign) else [getattr(part, "target", None)]
                names |= {target.id for target in targets if isinstance(target, ast.Name)}
            owners = {path.stem} | ({node.name} if isinstance(node, ast.ClassDef) else set())
            found |= names | {f"{owner}.{name}" for owner in owners for name in names}
    return found


def _resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, text: nodes.Element) -> nodes.Node | None:
    """Find the documented object that a short name means; an attribute without an entry links to its class."""
    if node.get("refdomain") != "py" or node["reftype"] != "obj":
        return None
    target, objects = node["reftarget"], env.domains["py"].objects  # type: ignore[attr-defined]
    for name in (target, target.rpartition(".")[0]):
        documented = {(objects[key].docname, objects[key].node_id) for key in objects if key.endswith(f".{name}")}
        if name and len(documented) == 1:
            page, anchor = documented.pop()
            return make_refnode(app.builder, node["refdoc"], page, anchor, text, target)
    known = target.startswith(("torch.", "PIL.")) or target in INHERITED or target in app.short_names  # type: ignore
    return text if known else None


def setup(app: Sphinx) -> dict[str, Any]:
    app.short_names = _names()  # type: ignore[attr-defined]
    app.connect("missing-reference", _resolve)
    return {"parallel_read_safe": True}
