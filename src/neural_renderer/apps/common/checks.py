"""Checks of options before a command is imported. This module imports neither torch nor NumPy.

The method ``validate()`` of the options of a command calls them, so that a wrong path is reported before torch is
imported, which takes seconds. Messages name arguments; the command line writes them as options.
"""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...base.requirements import existing, short_path

CHECKPOINT, REPORT = "checkpoint.pt", "report.json"
"""Files in the folder of a run."""
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
"""Suffixes of the pictures in a folder."""


class UsageError(ValueError):
    """Wrong usage of the command line. The exit code is 2."""


def check_counts(options: Any, **least: int) -> None:
    """Raise ValueError if an option is below its least value, given by keyword. Options that are None are skipped."""
    for name, limit in least.items():
        value = getattr(options, name)
        if value is not None and value < limit:
            raise ValueError(f"{name}: expected at least {limit}, got {value}")


def check_most(options: Any, **most: int) -> None:
    """Raise ValueError if an option is above its greatest value, given by keyword; None is skipped."""
    for name, limit in most.items():
        value = getattr(options, name)
        if value is not None and value > limit:
            raise ValueError(f"{name}: expected at most {limit}, got {value}")


def check_between(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError if an option is not above ``low`` and below ``high``."""
    if not low < value < high:
        limit = f" and below {high}" if math.isfinite(high) else ""
        raise ValueError(f"{name}: expected a number above {low}{limit}, got {value}")


def check_folder(option: str, folder: Path) -> None:
    """Raise OSError unless the folder of an option can be written or created. The folder is not created here."""
    place = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not place.is_dir() or not os.access(place, os.W_OK):
        reason = os.strerror(errno.EACCES if place.is_dir() else errno.ENOTDIR)
        raise OSError(f"{option}: expected a folder that can be written, got {folder} ({reason})")


def leads_outside(path: str | Path, folder: Path) -> bool:
    """Test whether a path in a folder leads out of it, by ``..`` or by symbolic links."""
    return not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def check_inside(output: Path, *names: str) -> None:
    """Raise ValueError if one of these folders in an output, whose files may be deleted, is a link out of it."""
    for name in names:
        if leads_outside(output / name, output):
            raise ValueError(f"output: expected folders of its own, got the link {output / name}, which leads outside")


def check_earlier(folder: Path, resume: bool, force: bool, results: Iterable[Path] = ()) -> None:
    """Raise FileExistsError if a run would overwrite the results of an earlier one without ``resume`` or ``force``.

    A checkpoint, a report or one of ``results`` in the folder shows that there was an earlier run.
    """
    has_checkpoint = (folder / CHECKPOINT).is_file()
    found = has_checkpoint or any(path.is_file() for path in (folder / REPORT, *results))
    if force or (resume and has_checkpoint) or not found:
        return
    continues = "resume=True continues it, " if has_checkpoint else ""
    raise FileExistsError(
        f"output: expected a folder without results, got {folder}, which has those of an earlier run; {continues}"
        "force=True replaces it, another folder keeps it"
    )


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Raise ValueError if an output file is an input or is referenced by one, like a texture. None is skipped."""
    given = [path for path in inputs if path is not None and path.is_file()]
    read = {(status.st_dev, status.st_ino) for status in map(Path.stat, given)}
    replaced = [output for output in outputs if output.exists()]
    for output in replaced:
        if (output.stat().st_dev, output.stat().st_ino) in read:
            raise ValueError(f"output: expected a file that may be replaced, got {output}, which is an input")
    if not (replaced and given):
        return
    from .named_files import names_file  # imports torch

    for output in replaced:
        for path in given:
            if names_file(path, output):
                raise ValueError(f"output: expected a file that may be replaced, got {output}, which {path} uses")


def picture_files(given: Iterable[Path]) -> list[Path]:
    """List pictures: the given files, and those in the given folders, by their names."""
    files: list[Path] = []
    for path in given:
        inside = sorted(f for f in path.iterdir() if f.suffix.lower() in PICTURE_SUFFIXES) if path.is_dir() else [path]
        if not inside:
            raise FileNotFoundError(f"{path}: expected pictures ({', '.join(PICTURE_SUFFIXES)}), got a folder without")
        files += inside
    if not files:
        raise ValueError("images: expected at least one picture, got none")
    return files


def check_inputs(*paths: Path | None) -> None:
    """Raise FileNotFoundError if an input file does not exist; None is skipped."""
    for path in paths:
        if path is not None:
            existing(path)


def check_cameras(path: Path | None) -> None:
    """Raise FileNotFoundError if a camera file, or a folder with one, does not exist; None is skipped."""
    if path is not None and not path.is_dir():
        existing(path, "a folder of images or a camera file")


def check_input_folder(folder: Path | None, what: str = "a folder") -> None:
    """Raise FileNotFoundError unless a path is a folder or None; the message calls it ``what``."""
    if folder is not None and not os.path.isdir(folder):
        existing(folder, what)
        raise FileNotFoundError(f"{short_path(folder)}: expected {what}, got a file")
