"""Lines on the terminal. This module does not import torch."""

from __future__ import annotations

import sys

from ...base.requirements import printable

INTERRUPTED = 130
"""Exit code after Ctrl-C, as of shells: 128 and the number of the signal."""


def say(text: str, color: str | None = None, markup: bool = False) -> None:
    """Print a line: to standard output, or in a colour, for warnings and errors, to standard error.

    Control characters, as of names of files, are escaped: they could move the cursor, or name the window.
    """
    if color is None and not markup:
        if sys.stdout is not None:  # None for a daemon
            sys.stdout.write(f"{printable(text)}\n")
            sys.stdout.flush()
        return
    from rich.console import Console  # takes time, which most commands save

    console = Console(stderr=color is not None)
    console.print(printable(text), style=color, markup=markup, highlight=False, soft_wrap=True)
