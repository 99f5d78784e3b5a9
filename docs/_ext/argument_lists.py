"""Reads the older dialect of docstrings, where arguments stand as "name: text" without a heading.

The lines become an "Args:" section (in classes "Attributes:"), which `sphinx.ext.napoleon` understands. Docstrings in
Google's style pass unchanged.
"""

import inspect
import re
from typing import Any

from sphinx.application import Sphinx

_ENTRY = re.compile(r"^(\w+(?:, \w+)*): +\S")
_HEADING = re.compile(r"^(Args|Attributes|Returns|Raises|Example|Examples|Note|Yields):$")


def with_headings(names: set[str], lines: list[str], heading: str) -> list[str]:
    """The docstring's lines, with ``heading`` before each run of entries for ``names``."""
    found: list[str] = []
    inside = section = False  # a run of entries; a section of Google's style
    for line in lines:
        if line and not line.startswith(" "):
            section = bool(_HEADING.match(line))
            entry = _ENTRY.match(line)
            starts = not section and entry is not None and set(entry[1].split(", ")) <= names
            if starts and not inside:
                found.append(heading)
            elif inside and not starts:
                found.append("")
            inside = starts
        elif not line and inside:
            inside = False
        found.append(f"    {line}" if inside else line)
    return found


def _process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    if what not in ("function", "method", "class"):
        return
    try:
        names = set(inspect.signature(obj).parameters)
    except (TypeError, ValueError):
        return
    lines[:] = with_headings(names, lines, "Attributes:" if what == "class" else "Args:")


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _process, priority=400)  # before napoleon, at 500
    return {"parallel_read_safe": True}
