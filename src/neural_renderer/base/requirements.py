"""Files and libraries that have to be there. This module imports neither torch nor NumPy."""

from __future__ import annotations

import importlib
import importlib.util
import os
from pathlib import Path
from typing import Any

from .extras import advice


def existing(path: str | os.PathLike[str], what: str = "a file") -> Path:
    """Return ``path`` if it is a file; raise FileNotFoundError otherwise, which calls it ``what``."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: expected {what}, got {_found(path)}")
    return Path(path)


def existing_folder(path: str | os.PathLike[str], what: str = "a folder") -> Path:
    """Return ``path`` if it is a folder; raise FileNotFoundError otherwise, which calls it ``what``."""
    if not Path(path).is_dir():
        raise FileNotFoundError(f"{path}: expected {what}, got {'a file' if Path(path).is_file() else _found(path)}")
    return Path(path)


def _found(path: str | os.PathLike[str]) -> str:
    if os.path.exists(path):
        return "a folder" if os.path.isdir(path) else "a device or pipe"
    return "a link that leads nowhere" if os.path.islink(path) else "nothing there"


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
