"""The files that a file names: found whatever their case, and only in its own folder unless more is asked for."""

from __future__ import annotations

import os
from pathlib import Path

from .files import short


def find_file(source: Path, name: str, *folders: Path, allow_outside: bool = False) -> Path | None:
    """The regular file that ``source`` calls ``name``, or None.

    Looked for in each of the folders (by default that of ``source``) as written, then by its last part alone (exporters
    leave paths of their own machine); backslashes are separators, and upper and lower case are told apart only where
    both exist. Without ``allow_outside``, nothing outside the folder of ``source`` is looked at: a name whose ``..``
    lead there raises ValueError, and an absolute path is not found.
    """
    folders, home = folders or (source.parent,), source.parent
    relative = name[len(Path(name).drive) :].replace("\\", "/")
    parts = [part for part in relative.split("/") if part not in ("", ".")]
    beyond = False
    for folder in folders if parts else ():
        inner = _inside("/".join([str(folder), *parts]), home)
        beyond |= inner is None
        found = _walk(home, inner.parts) if inner is not None else _walk(folder, parts) if allow_outside else None
        if found is not None:
            return found
    for folder in folders if parts else ():
        found = _walk(folder, parts[-1:])
        if found is not None:
            return found
    absolute = Path(name)
    if absolute.is_absolute() and (allow_outside or _inside(name, home)) and is_file(absolute):
        return absolute
    if beyond and not allow_outside:
        raise outside(source, name)
    return None


def is_outside(source: Path, name: str) -> bool:
    """Whether a name in the file ``source`` leads out of its folder, by ``..`` or as an absolute path."""
    return _inside(os.path.join(source.parent, name), source.parent) is None


def outside(source: Path, name: str) -> ValueError:
    """The error for a name in the file ``source`` that leads out of its folder."""
    return ValueError(
        f"{source}: expected names of files in its folder, got {short(name)}, which leads out of it; "
        "allow_outside=True (--allow-outside) reads it all the same"
    )


def _inside(path: str, home: Path) -> Path | None:
    """``path`` relative to the folder ``home``, or None where it is not in there.

    The name decides and not the disk: nobody learns what lies elsewhere, and a link in the folder may lead anywhere.
    """
    whole, base = Path(os.path.abspath(path)), Path(os.path.abspath(home))
    return whole.relative_to(base) if whole.is_relative_to(base) else None


def _walk(folder: Path, parts: tuple[str, ...] | list[str]) -> Path | None:
    try:
        for part in parts:
            step = folder / part
            if not step.exists():
                entries = folder.iterdir() if folder.is_dir() else iter(())
                alike = next((entry for entry in entries if entry.name.lower() == part.lower()), None)
                if alike is None:
                    return None
                step = alike
            folder = step
    except OSError:  # a name that is too long, a folder that may not be looked into
        return None
    return folder if is_file(folder) else None


def is_file(path: Path) -> bool:
    """Whether it is a regular file: at a device or a pipe, a reader would wait."""
    try:
        return path.is_file()
    except OSError:
        return False
