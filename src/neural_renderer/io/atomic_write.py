"""Atomic writing: a file is written completely or not at all.

New files are written into a temporary folder beside their target, synced to the disk, and then renamed. A full disk, an
error, Ctrl-C or a kill before that leaves the old files.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import shutil
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PREFIX = ".neural_renderer-"  # beginning of the names of temporary folders
_LONGEST_REASON = 120  # characters
_LOST = 24 * 3600.0  # seconds after which a temporary folder of another machine is left over


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Convert errors of a failed write to an OSError that names ``path`` and keeps ``errno``."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # a full disk is a RuntimeError in torch.save
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:_LONGEST_REASON]
        named = OSError(f"{os.fspath(path)}: expected to write it, got: {reason}")
        named.errno = getattr(error, "errno", None)
        raise named from error


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write ``path`` and files beside it, all or none; OSError if that fails.

    Yields a path of the same name in a temporary folder. At the end of the block, all files in that folder are synced
    and renamed into the folder of ``path``, with ``path`` last. If a rename fails, or Ctrl-C comes between two of them,
    those before it are undone. Missing folders are made, permissions of replaced files are kept. Symbolic links are
    followed inside their folder; one that leads outside is replaced. The next write into the same folder cleans up
    after a killed process: it deletes temporary files, and restores the old files of a set that was renamed in part.
    """
    path = Path(path)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _check_replaceable(path)
        sweep(path.parent, restore=True)
        staging = make_staging(path.parent)
        fresh = staging / "new" / path.name
        try:
            fresh.parent.mkdir()
            yield fresh
            others = sorted(file for file in fresh.parent.iterdir() if file != fresh)
            _publish([*others, fresh], path.parent, staging / "old")
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def write_file(path: str | os.PathLike[str], content: bytes | memoryview | str) -> None:
    """Write bytes, or text as UTF-8, completely or not at all. Raises OSError as `replacing`."""
    with replacing(path) as fresh:
        fresh.write_bytes(content.encode() if isinstance(content, str) else content)


def _publish(files: list[Path], folder: Path, old: Path) -> None:
    """Sync the files and rename them into ``folder``, all or none of them."""
    targets = [_target(folder / file.name) for file in files]
    for file, target in zip(files, targets, strict=True):
        with file.open("rb+") as opened:
            os.fsync(opened.fileno())
        if target.exists():
            _check_replaceable(target)
            shutil.copymode(target, file)
    if len(files) > 1:  # a single rename needs no undo
        old.mkdir()
        for target in filter(Path.exists, targets):
            _copy(target, old / target.name)
    done: list[Path] = []
    try:
        for file, target in zip(files, targets, strict=True):
            done.append(target)
            _rename(file, target)
    except BaseException:  # Ctrl-C, too
        for file, target in reversed(list(zip(files, done, strict=False))):
            if (old / target.name).exists():
                _rename(old / target.name, target)
            elif not file.exists():  # it was renamed, and there was nothing before
                target.unlink(missing_ok=True)
        raise
    _sync_folder(folder)


def _target(path: Path) -> Path:
    """Follow a symbolic link, but not out of its folder: the folder may come from others."""
    target = Path(os.path.realpath(path))
    return target if target.is_relative_to(os.path.realpath(path.parent)) else path


def _rename(file: Path, target: Path) -> None:
    """Rename a file over another one, even if a symbolic link has put that on another file system."""
    try:
        os.replace(file, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        staging = make_staging(target.parent)
        try:
            shutil.copy2(file, staging / target.name)
            with (staging / target.name).open("rb+") as opened:
                os.fsync(opened.fileno())
            os.replace(staging / target.name, target)
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def make_staging(folder: Path) -> Path:
    """Make a temporary folder in ``folder``, whose name says which process owns it, for `sweep`."""
    return Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{_machine()}-{os.getpid()}-", dir=folder))


def _sync_folder(folder: Path) -> None:
    """Flush the renames to the disk, on systems that can open folders."""
    with suppress(OSError):
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def _copy(source: Path, copy: Path) -> None:
    """Make a hard link, or a copy on file systems without links."""
    try:
        os.link(source, copy)
    except OSError:
        shutil.copy2(source, copy)


def _check_replaceable(path: Path) -> None:
    """Raise OSError if ``path`` cannot be written to. A rename would replace it all the same."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if path.exists() and not path.is_file():
        raise OSError("not a regular file")
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def sweep(folder: Path, restore: bool = False, others: bool = False) -> None:
    """Delete temporary folders of processes that were killed on this machine, and with ``others`` old ones of any.

    Their old files may be restored before, where nobody else can write into ``folder``.
    """
    if os.name != "posix":
        return  # on Windows, os.kill(pid, 0) does not test whether a process exists
    pattern = rf"{re.escape(_PREFIX)}{_machine()}-(\d+)-\w+"
    for name in os.listdir(folder):
        if not name.startswith(_PREFIX):
            continue
        found = re.fullmatch(pattern, name)
        if found and _alive(int(found[1])):
            continue
        if found and restore:
            with suppress(OSError):
                _restore(folder / name)
        if found or (others and _age(folder / name) > _LOST):
            shutil.rmtree(folder / name, ignore_errors=True)


def _age(path: Path) -> float:
    """Return the seconds since a folder was made or changed; 0 if it is gone."""
    with suppress(OSError):
        return time.time() - path.stat().st_mtime
    return 0.0


def _restore(staging: Path) -> None:
    """Restore the old files of a set if a killed process has renamed some of the new ones and not all."""
    old, new = staging / "old", staging / "new"
    if not old.is_dir() or not any(new.iterdir()):
        return
    begun = old.stat().st_mtime_ns
    for backup in old.iterdir():
        target = staging.parent / backup.name
        if target.is_file() and target.stat().st_mtime_ns <= begun:  # nobody has changed it since
            os.replace(backup, target)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass  # it belongs to another user, for example
    return True


def _machine() -> str:
    """Identify the machine and, in a container, its PID namespace: process ids are comparable only within these."""
    space = ""
    with suppress(OSError):
        space = os.readlink("/proc/self/ns/pid")
    return f"{zlib.crc32(f'{platform.node()} {space}'.encode()):08x}"
