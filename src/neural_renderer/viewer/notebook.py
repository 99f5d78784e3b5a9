"""The viewer's page in a notebook's output, and its address elsewhere."""

from __future__ import annotations

import html
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rich.console import Console

if TYPE_CHECKING:
    from .viewer import Viewer

_HEIGHT = 560  # pixels


def announce(viewer: Viewer) -> None:
    """Show the page in the output of a notebook, or print its address."""
    if in_notebook():
        module: Any = import_module("IPython.display")
        module.display(module.HTML(frame_of(viewer)))
        return
    Console().print(f"viewer: {viewer.url}", highlight=False, soft_wrap=True)


def in_notebook() -> bool:
    """Tell whether this program runs in the kernel of a notebook."""
    module: Any = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def frame_of(viewer: Viewer) -> str:
    """Make the HTML that shows the page; without a page the address stays empty."""
    if viewer.url is None:
        return "<i>viewer without a page</i>"
    url = html.escape(viewer.url, quote=True)
    return (
        f'<div><iframe src="{url}" width="100%" height="{_HEIGHT}" style="border:1px solid #ddd;border-radius:6px" '
        f'allow="fullscreen"></iframe><small>If nothing appears, open <a href="{url}" target="_blank">{url}</a>; from '
        "another machine, forward the port: <code>ssh -L</code>.</small></div>"
    )
