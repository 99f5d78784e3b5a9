"""The one way files are written: whole, or not at all.

New files are written into a folder of their own beside their target, synced to the disk, and then renamed. A full disk,
an error, Ctrl-C or a kill before that leaves what was there before.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PREFIX = ".neural_renderer-"


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn whatever a failed write raises into an OSError that names ``path``; its ``errno`` is kept."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # a full disk is a RuntimeError in torch.save
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:120]
        named = OSError(f"{os.fspath(path)}: expected to write it, got: {reason}")
        named.errno = getattr(error, "errno", None)
        raise named from error


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write ``path``, and the files that belong to it, whole or not at all.

    Yields a path of the same name in a new folder. When the block ends, the file there and all others that were put
    beside it are synced and renamed into the folder of ``path``, ``path`` last. If one rename fails, those before it
    are taken back. Missing folders are made, the permissions of a file that is replaced stay, and a symbolic link is
    followed. What a killed process has left is deleted when the next file is written into that folder.

    Raises:
        OSError: ``path`` cannot be written, is a folder or no regular file, or is write-protected. The file is named.

    Example:
        >>> with replacing("a.txt") as fresh:   # doctest: +SKIP
        ...     fresh.write_text("whole")
    """
    path = Path(path)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _check_replaceable(path)
        _sweep(path.parent)
        staging = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{_machine()}-{os.getpid()}-", dir=path.parent))
        fresh = staging / "new" / path.name
        try:
            fresh.parent.mkdir()
            yield fresh
            others = sorted(file for file in fresh.parent.iterdir() if file != fresh)
            _publish([*others, fresh], path.parent, staging / "old")
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def write_file(path: str | os.PathLike[str], content: bytes | memoryview | str) -> None:
    """Write bytes, or text as UTF-8, whole or not at all; errors as `replacing`."""
    with replacing(path) as fresh:
        fresh.write_bytes(content.encode() if isinstance(content, str) else content)


def _publish(files: list[Path], folder: Path, old: Path) -> None:
    """Sync the files and rename them into ``folder``, all or none of them."""
    targets = [Path(os.path.realpath(folder / file.name)) for file in files]
    for file, target in zip(files, targets, strict=True):
        with file.open("rb+") as opened:
            os.fsync(opened.fileno())
        if target.exists():
            _check_replaceable(target)
            shutil.copymode(target, file)
    if len(files) > 1:  # one rename needs no way back
        old.mkdir()
        for target in filter(Path.exists, targets):
            _copy(target, old / target.name)
    done: list[Path] = []
    try:
        for file, target in zip(files, targets, strict=True):
            os.replace(file, target)
            done.append(target)
    except OSError:
        for target in reversed(done):
            if (old / target.name).exists():
                os.replace(old / target.name, target)
            else:
                target.unlink()
        raise


def _copy(source: Path, copy: Path) -> None:
    """A second name for the same file, or, where the file system knows no such thing, a second file."""
    try:
        os.link(source, copy)
    except OSError:
        shutil.copy2(source, copy)


def _check_replaceable(path: Path) -> None:
    """Raise OSError for what a rename would replace although writing into it would not work."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if path.exists() and not path.is_file():
        raise OSError("it is no regular file")
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _sweep(folder: Path) -> None:
    """Delete what processes that were killed on this machine left in a folder."""
    if os.name != "posix":
        return  # elsewhere, os.kill(pid, 0) does not ask whether a process lives
    for name in os.listdir(folder):
        found = name.startswith(_PREFIX) and re.fullmatch(rf"{re.escape(_PREFIX)}{_machine()}-(\d+)-\w+", name)
        if found and not _alive(int(found[1])):
            shutil.rmtree(folder / name, ignore_errors=True)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass  # it belongs to another user, for example
    return True


def _machine() -> str:
    """Tells where a process id means the same: this machine and, in a container, its name space of processes."""
    space = ""
    with suppress(OSError):
        space = os.readlink("/proc/self/ns/pid")
    return f"{zlib.crc32(f'{platform.node()} {space}'.encode()):08x}"
