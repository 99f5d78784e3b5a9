"""Warp's cache of compiled kernels: recompile damaged ones, and remove what killed processes left behind."""

from __future__ import annotations

import errno
import os
import re
import shutil
import time
import warnings
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import warp as wp

from ...base import private

_ROOM = 1 << 20  # free bytes, more than any module needs: on a full disk LLVM would end the process
_LEFT_BEHIND = re.compile(r"wp_neural_renderer\..*_p\d+_t\d+")
_COMPILED = (".o", ".ptx", ".cubin", ".meta")  # suffixes of the files that Warp loads
_ATTEMPTS = 2
_HOUR = 3600.0  # seconds; no module takes longer to compile


def load_module(kernel: wp.Kernel, device: str) -> None:
    """Load a kernel's module from the cache for a device of Warp; compile it first if it is missing or damaged.

    Raises:
        OSError: The disk is full, or a damaged file cannot be removed. The message names the folder.
    """
    removed = 0
    while True:
        name = private.identifier(kernel.module, device)
        if name is None:  # the cache cannot be repaired
            return _load(kernel, device)
        if not _is_known(kernel.module):
            _prepare()
        folder = _cache() / name
        try:
            _check_sums(folder)
            _load(kernel, device)
            return _note_sums(folder)
        except Exception as error:
            # A full disk or a power cut damages files. Another process may remove the same files, and new ones.
            gone = isinstance(error, FileNotFoundError)
            damaged = gone or (not isinstance(error, OSError) and (folder.exists() or removed))
            if not damaged or removed == _ATTEMPTS:
                raise
            _remove(folder, error)
            kernel.module.unload()
            removed += 1


def _remove(folder: Path, error: Exception) -> None:
    if folder.exists():
        shutil.rmtree(folder, ignore_errors=True)
        if folder.exists():
            raise OSError(f"a damaged kernel ({error}); delete {folder}") from error
        warnings.warn(f"{folder}: expected a compiled kernel, got a damaged one; it is compiled again", stacklevel=2)


def _load(kernel: wp.Kernel, device: str) -> None:
    wp.load_module(kernel.module, device=device)
    if not private.is_loaded(kernel):  # a file of zeros also loads, but has no kernels
        raise RuntimeError(f"no kernel {kernel.key} in it")


def _check_sums(folder: Path) -> None:
    """Raise RuntimeError if a compiled file differs from its checksum: LLVM ends the process on wrong bits."""
    for path, known in _compiled(folder):
        if known and _sum(path) not in known:
            raise RuntimeError(f"wrong checksum of {path.name}")


def _note_sums(folder: Path) -> None:
    """Store missing checksums as names of empty files, because creating one is atomic."""
    for path, known in _compiled(folder):
        if not known:
            with suppress(OSError):  # a folder of another user
                _sum(path).touch()


def _compiled(folder: Path) -> Iterator[tuple[Path, set[Path]]]:
    """List the files that Warp loads, each with the files that are its checksums."""
    files = set(folder.iterdir()) if folder.exists() else set()
    for path in files:
        if path.suffix in _COMPILED:
            yield path, {file for file in files if file.stem == path.name}


def _sum(path: Path) -> Path:
    return path.with_name(f"{path.name}.{zlib.crc32(path.read_bytes()):08x}")


def _cache() -> Path:
    return Path(str(wp.config.kernel_cache_dir))


def _is_known(module: wp.Module) -> bool:
    """Test whether the cache has the module, perhaps with other code."""
    name = re.compile(rf"wp_{re.escape(module.name)}_[0-9a-f]+")
    return any(name.fullmatch(path.name) for path in _cache().iterdir())


def _prepare() -> None:
    """Check the free space, and remove folders of processes that were killed while compiling."""
    for path in _cache().iterdir():
        with suppress(OSError):  # another process may remove it first
            if _LEFT_BEHIND.fullmatch(path.name) and time.time() - path.stat().st_mtime > _HOUR:
                shutil.rmtree(path)
    if shutil.disk_usage(_cache()).free < _ROOM:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
