"""The directive ``command-help``: a section for each command, with the text that ``--help`` prints."""

import contextlib
import io
import os
from collections.abc import Iterator
from typing import Any
from unittest import mock

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from neural_renderer.apps import command_line

_TERMINAL = {"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}


def helps() -> Iterator[tuple[str, str]]:
    """Yield each line that asks for help, the list of commands first, and what it prints."""
    for words in ([], *(name.split() for name in command_line.command_names())):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), mock.patch.dict(os.environ, _TERMINAL):
            command_line.main([*words, "--help"])
        text = "\n".join(line.rstrip() for line in printed.getvalue().splitlines())
        yield " ".join(["neural-renderer", *words]), text


class CommandHelp(SphinxDirective):
    """Makes the sections."""

    def run(self) -> list[nodes.Node]:
        sections: list[nodes.Node] = []
        for name, text in helps():
            section = nodes.section("", nodes.title(name, name), nodes.literal_block(text, text, language="none"))
            section["ids"].append(nodes.make_id(name))
            sections.append(section)
        return sections


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
