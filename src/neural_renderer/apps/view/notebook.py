"""The viewer's page in a notebook's output, and its address elsewhere."""

from __future__ import annotations

import html
import sys
from importlib import import_module
from typing import Any

from rich.console import Console

_HEIGHT = 560  # pixels


def announce(url: str | None) -> None:
    """Show the page at an address in the output of a notebook, or print the address."""
    if in_notebook():
        module: Any = import_module("IPython.display")
        module.display(module.HTML(frame_of(url)))
        return
    Console().print(f"viewer: {url}", highlight=False, soft_wrap=True)


def in_notebook() -> bool:
    """Return whether this program runs in the kernel of a notebook."""
    module: Any = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def frame_of(url: str | None) -> str:
    """Make the HTML that shows the page at an address; None stands for a viewer without a page."""
    if url is None:
        return "<i>viewer without a page</i>"
    url = html.escape(url, quote=True)
    return (
        f'<div><iframe src="{url}" width="100%" height="{_HEIGHT}" style="border:1px solid #ddd;border-radius:6px" '
        f'allow="fullscreen"></iframe><small>If nothing appears, open <a href="{url}" target="_blank">{url}</a>; from '
        "another machine, forward the port: <code>ssh -L</code>.</small></div>"
    )
