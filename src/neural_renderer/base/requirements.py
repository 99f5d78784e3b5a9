"""Files and libraries that have to be there. This module imports neither torch nor NumPy."""

from __future__ import annotations

import importlib
import importlib.util
import os
from pathlib import Path
from typing import Any
from unicodedata import category

from .extras import advice

_LONGEST_PATH, _LONGEST_END = 250, 80  # characters of a path in a message; of each end of one that is longer


def existing(path: str | os.PathLike[str], what: str = "a file") -> Path:
    """Return ``path`` if it is a file; raise FileNotFoundError otherwise, which calls it ``what``."""
    try:
        if Path(path).is_file():
            return Path(path)
        found = _found(path)
    except (OSError, ValueError, RuntimeError) as error:  # a null byte, a name that is too long, links in a circle
        found = f"a name that no file can have ({getattr(error, 'strerror', None) or error})"
    raise FileNotFoundError(f"{short_path(path)}: expected {what}, got {found}")


def _found(path: str | os.PathLike[str]) -> str:
    if os.path.exists(path):
        return "a folder" if os.path.isdir(path) else "a device or pipe"
    return "a link that leads nowhere" if os.path.islink(path) else "nothing there"


def short_path(path: str | os.PathLike[str]) -> str:
    """Format a path for a message: control characters are escaped, the middle of a long one is left out."""
    name = printable(os.fspath(path))
    return name if len(name) < _LONGEST_PATH else f"{name[:_LONGEST_END]}...{name[-_LONGEST_END:]}"


def printable(text: str) -> str:
    """Escape control characters, but not line ends."""
    if text.isprintable():
        return text
    shown = (char.isprintable() or char == "\n" or category(char) == "Zs" for char in text)  # Zs: all scripts' spaces
    return "".join(char if is_shown else repr(char)[1:-1] for char, is_shown in zip(text, shown, strict=True))


def require_library(name: str, use: str) -> None:
    """Raise ModuleNotFoundError if a library is not installed, without importing it; see `import_library`."""
    if importlib.util.find_spec(name) is None:
        raise _missing(name, use)


def import_library(name: str, use: str) -> Any:
    """Import an optional library, or one of its modules; ``use`` says what for: "to make charts"."""
    library = name.partition(".")[0]
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in (library, name):
            raise
        raise _missing(library, use) from None


def _missing(library: str, use: str) -> ModuleNotFoundError:
    return ModuleNotFoundError(f"expected {library} to be installed {use} ({advice(library)})", name=library)
