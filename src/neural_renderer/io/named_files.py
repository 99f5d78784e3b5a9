"""Search for the files that a mesh file names, by default only inside its folder."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from .files import short

Listings = dict[Path, dict[str, str]]  # of folders: the names in them by those in lower case


def find_file(
    source: Path, name: str, *folders: Path, allow_outside: bool = False, listings: Listings | None = None
) -> Path | None:
    """Find the file ``name`` that the file ``source`` refers to, in folders, by default its own; None if it is missing.

    The full name is searched first, then its last part, because exporters write paths of their own machine.
    Backslashes are separators. Upper and lower case differ only if both files exist. Without ``allow_outside``, files
    outside the folder of ``source`` are not found; ValueError if ``..`` leads there. With ``listings``, filled here,
    calls for many names list each folder once.
    """
    folders, home = tuple(dict.fromkeys(folders or (source.parent,))), source.parent
    walk = partial(_walk, {} if listings is None else listings)
    relative = name[len(Path(name).drive) :].replace("\\", "/")
    parts = [part for part in relative.split("/") if part not in ("", ".")]
    beyond = False
    for folder in folders if parts else ():
        inner = _inside("/".join([str(folder), *parts]), home)
        beyond |= inner is None
        found = walk(home, inner.parts) if inner is not None else walk(folder, parts) if allow_outside else None
        if found is not None:
            return found
    for folder in folders if parts else ():
        found = walk(folder, parts[-1:])
        if found is not None:
            return found
    absolute = Path(name)
    if absolute.is_absolute() and (allow_outside or _inside(name, home)) and is_file(absolute):
        return absolute
    if beyond and not allow_outside:
        raise outside_error(source, name)
    return None


def is_outside(source: Path, name: str) -> bool:
    """Test whether a name in ``source`` refers outside its folder, by ``..`` or as an absolute path."""
    return _inside(os.path.join(source.parent, name), source.parent) is None


def outside_error(source: Path, name: str) -> ValueError:
    """Make the error for a name in ``source`` that refers outside its folder."""
    return ValueError(
        f"{source}: expected names of files in its folder, got {short(name)}, which is outside; "
        "allow_outside=True permits it"
    )


def _inside(path: str, home: Path) -> Path | None:
    """Return ``path`` relative to the folder ``home``, or None if it is outside.

    Only the name decides. The disk is not read, so a file cannot probe for others, and links inside the folder work.
    """
    whole, base = Path(os.path.abspath(path)), Path(os.path.abspath(home))
    return whole.relative_to(base) if whole.is_relative_to(base) else None


def _walk(listings: Listings, folder: Path, parts: tuple[str, ...] | list[str]) -> Path | None:
    """Follow the parts of a path from ``folder``, in any case; return the regular file at its end, or None."""
    try:
        for part in parts:
            step = folder / part
            if not step.exists():
                if folder not in listings:
                    entries = os.listdir(folder) if folder.is_dir() else []
                    listings[folder] = {entry.lower(): entry for entry in reversed(entries)}
                if part.lower() not in listings[folder]:
                    return None
                step = folder / listings[folder][part.lower()]
            folder = step
    except OSError:  # the name is too long, or a folder is not readable
        return None
    return folder if is_file(folder) else None


def is_file(path: Path) -> bool:
    """Test whether ``path`` is a regular file. Reading a device or a pipe could block."""
    try:
        return path.is_file()
    except OSError:
        return False
