"""Files that are either whole or as they were before."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raises OSError, naming the file, whatever kind of error a full disk becomes on its way."""
    path = Path(path)
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:120]
        raise OSError(f"{path}: expected to write it, got: {reason}") from error


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A name to write a file under that takes the place of ``path`` once it is whole; else ``path`` stays as it was.

    The name ends as ``path`` does, and the folder is made if missing. Errors as `writing`.
    """
    path = Path(path)
    fresh = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield fresh
            fresh.replace(path)
    finally:
        with suppress(OSError):
            fresh.unlink(missing_ok=True)
